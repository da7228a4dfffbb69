use tiepoint_experiments::{BASELINE_M, Plan, render, render_collection, write_depths, write_scan};
use tiepoint_synth::trajectory::{Carrier, Motion};
use tiepoint_synth::{CollectionOptions, DriveOptions, Mount, RouteKind};

use crate::args::Synth;
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;

pub(crate) fn synth(args: &Synth, output: &Output) -> Result<(), Failure> {
    if let Some(kind) = args.collection {
        let options = CollectionOptions { kind, seed: args.seed, photos: args.photos };
        let rendered = render_collection(&args.output, &options, &mut Progress::new(output))?;
        return output.result(&rendered, || rendered.describe());
    }
    let plan = plan(args);
    let drive = plan.drive()?;
    let mut progress = Progress::new(output);
    let rendered = render(&plan, &drive, &mut progress)?;
    if args.scan {
        write_scan(&plan, &drive)?;
    }
    if args.depths {
        write_depths(&plan, &drive)?;
    }
    drop(progress);
    output.result(&rendered, || rendered.describe())
}

fn plan(args: &Synth) -> Plan {
    let options = DriveOptions {
        seed: args.seed,
        route: args.route,
        length_m: args.length,
        motion: match (args.carrier, args.route) {
            (Carrier::Car, RouteKind::Highway) => Motion::highway(),
            (carrier, _) => Motion::of(carrier),
        },
        mounts: Mount::stereo(args.view_direction, BASELINE_M).to_vec(),
        width: args.size.width,
        height: args.size.height,
        rate_hz: args.rate,
        effects: args.effects,
        ..DriveOptions::default()
    };
    Plan { folder: args.output.clone(), frames: args.frames, options }
}
