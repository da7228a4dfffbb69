use tiepoint_experiments::{Scenery, constraints, view_directions};

use crate::args::{self, Experiment};
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

pub(crate) fn experiment(experiment: &Experiment, output: &Output) -> Result<(), Failure> {
    let mut progress = Progress::new(output);
    let outcome = match experiment {
        Experiment::Mounting(args) => view_directions(&scenery(args), &mut progress)?,
        Experiment::Baseline { scenery: args, rig } => {
            constraints(&scenery(args), rig, &mut progress)?
        }
    };
    drop(progress);
    output.result(&outcome, || outcome.describe())
}

fn scenery(args: &args::Scenery) -> Scenery {
    Scenery {
        folder: args.output.clone(),
        frames: args.frames,
        size: [args.size.width, args.size.height],
        seed: args.seed,
        rate_hz: args.rate,
        route: args.route,
        length_m: args.length,
        effects: args.effects,
        pairs: args.pairs,
        has_dense_clouds: !args.no_dense,
    }
}
