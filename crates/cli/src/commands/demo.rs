use tiepoint_experiments::DemoOptions;

use crate::args::Demo;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

pub(crate) fn demo(args: &Demo, output: &Output) -> Result<(), Failure> {
    let options = DemoOptions {
        folder: args.output.clone(),
        frames: args.frames,
        size: [args.size.width, args.size.height],
        seed: args.seed,
    };
    let mut progress = Progress::new(output);
    let outcome = tiepoint_experiments::demo(&options, &mut progress)?;
    drop(progress);
    output.result(&outcome, || outcome.describe())
}
