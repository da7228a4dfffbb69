//! `reconstruct`, its stages `features`, `match` and `map`, and the stage `dense`.

use tiepoint_pipeline::sfm::MapperOptions;
use tiepoint_pipeline::stages::{
    DenseOptions, FeatureOptions, InputModel, MapOptions, MatchOptions, OpenedInput,
    PositionPriors, dense as dense_workspace, extract_features, extract_shard, import_features,
    map as map_workspace, map_submap, match_images as match_workspace, match_shard, open_input,
    open_shared_input,
};
use tiepoint_pipeline::{Options, Stage, Workspace, reconstruct as reconstruct_all};

use crate::args::{
    Cameras, Dense, Features, Input, MEGA, Map, Mapping, Match, Metres, Pairs, PositivePixels,
    Reconstruct, Seed,
};
use crate::failure::Failure;
use crate::output::Output;
use crate::progress::Progress;
use crate::summary::{self, PhotoOptions};

pub(crate) fn reconstruct(args: &Reconstruct, output: &Output) -> Result<(), Failure> {
    if args.redo == Some(Stage::Dense) && !args.dense {
        return Err(Failure::Usage(
            "this command does not run the stage dense without --dense: add it, or give --redo \
             dense to `tiepoint dense`"
                .to_owned(),
        ));
    }
    check_max_size(&args.input, args.dense)?;
    let dense = args
        .dense
        .then(|| DenseOptions { max_image_size: args.input.max_size, ..DenseOptions::default() });
    let options = Options {
        database: args.input.database.clone(),
        features: feature_options(&args.input, &args.cameras)?,
        masks: args.input.masks.clone(),
        every: args.input.every,
        matching: match_options(&args.pairs, &args.seed),
        mapping: map_options(&args.mapping, &args.seed)?,
        dense,
        redo: args.redo,
    };
    let mut progress = Progress::new(output);
    let workspace = &args.input.output;
    let report = reconstruct_all(&args.input.inputs, workspace, &options, &mut |event| {
        progress.watch(event)
    })?;
    drop(progress);
    let photos = PhotoOptions { masks: args.input.masks.as_deref(), max_size: args.input.max_size };
    output.result(&report, || summary::report(workspace, &report, photos))
}

pub(crate) fn features(args: &Features, output: &Output) -> Result<(), Failure> {
    let redo = check_redo(args.redo, Stage::Features)?;
    check_max_size(&args.input, false)?;
    let mut options = feature_options(&args.input, &args.cameras)?;
    let mut progress = Progress::new(output);
    let Input { inputs, output: root, masks, every, database, .. } = &args.input;
    if let Some(file) = database {
        let mut workspace = Workspace::create(root)?;
        import_features(file, inputs, &mut workspace, redo, &mut |event| progress.watch(event))?;
        drop(progress);
        return print_report(&workspace, PhotoOptions::default(), output);
    }
    if let Some(shard) = args.shard {
        let OpenedInput { photos, workspace, .. } =
            open_shared_input(inputs, masks.as_deref(), root)?;
        let report = extract_shard(&photos, &workspace, &options, shard, redo, &mut |event| {
            progress.watch(event)
        })?;
        drop(progress);
        return output.result(&report, || summary::shard(&report));
    }
    let OpenedInput { photos, mut workspace, timestamps } =
        open_input(inputs, masks.as_deref(), root, *every, redo, &mut |event| {
            progress.watch(event)
        })?;
    options.timestamps = options.timestamps.or(timestamps);
    extract_features(&photos, &mut workspace, &options, redo, &mut |event| progress.watch(event))?;
    drop(progress);
    print_report(&workspace, PhotoOptions::default(), output)
}

pub(crate) fn match_images(args: &Match, output: &Output) -> Result<(), Failure> {
    let redo = check_redo(args.redo, Stage::Match)?;
    let options = match_options(&args.pairs, &args.seed);
    if let Some(shard) = args.shard {
        let workspace = Workspace::open_shared(&args.workspace)?;
        let mut progress = Progress::new(output);
        let report =
            match_shard(&workspace, &options, shard, redo, &mut |event| progress.watch(event))?;
        drop(progress);
        return output.result(&report, || summary::shard(&report));
    }
    let mut workspace = Workspace::open(&args.workspace)?;
    let mut progress = Progress::new(output);
    match_workspace(&mut workspace, &options, redo, &mut |event| progress.watch(event))?;
    drop(progress);
    print_report(&workspace, PhotoOptions::default(), output)
}

pub(crate) fn map(args: &Map, output: &Output) -> Result<(), Failure> {
    let redo = check_redo(args.redo, Stage::Map)?;
    let options =
        MapOptions { merges_submaps: args.merge, ..map_options(&args.mapping, &args.seed)? };
    if let Some(number) = args.submap {
        let mut workspace = Workspace::open_shared(&args.workspace)?;
        let mut progress = Progress::new(output);
        let report =
            map_submap(&mut workspace, &options, number, redo, &mut |event| progress.watch(event))?;
        drop(progress);
        return output.result(&report, || summary::shard(&report));
    }
    let mut workspace = Workspace::open(&args.workspace)?;
    let mut progress = Progress::new(output);
    map_workspace(&mut workspace, &options, redo, &mut |event| progress.watch(event))?;
    drop(progress);
    print_report(&workspace, PhotoOptions::default(), output)
}

pub(crate) fn dense(args: &Dense, output: &Output) -> Result<(), Failure> {
    let redo = check_redo(args.redo, Stage::Dense)?;
    let mut workspace = Workspace::open(&args.workspace)?;
    let mut progress = Progress::new(output);
    let options = DenseOptions {
        max_image_size: args.max_size,
        masks: args.masks.clone(),
        write_normal_maps: args.normal_maps,
        write_depth_pngs: args.depth_pngs,
        ..DenseOptions::default()
    };
    dense_workspace(&mut workspace, &options, redo, &mut |event| progress.watch(event))?;
    drop(progress);
    let photos = PhotoOptions { masks: args.masks.as_deref(), max_size: args.max_size };
    print_report(&workspace, photos, output)
}

fn print_report(
    workspace: &Workspace,
    photos: PhotoOptions,
    output: &Output,
) -> Result<(), Failure> {
    let report = workspace.report()?;
    output.result(&report, || summary::report(workspace.root(), &report, photos))
}

/// Checks that --redo of a command for one stage names this stage.
fn check_redo(redo: Option<Stage>, own: Stage) -> Result<Option<Stage>, Failure> {
    match redo {
        Some(stage) if stage != own => Err(Failure::Usage(format!(
            "this command runs the stage {own}, so --redo can only be {own} here"
        ))),
        _ => Ok(redo),
    }
}

/// Checks that --max-size has something to reduce: keypoints of a database are given.
fn check_max_size(input: &Input, has_dense: bool) -> Result<(), Failure> {
    if input.database.is_none() || input.max_size.is_none() || has_dense {
        return Ok(());
    }
    Err(Failure::Usage(
        "--max-size reduces photos before keypoints are detected in them, and --database has \
        keypoints: leave one of the two out, or reduce the depth maps by `reconstruct --dense`"
            .to_owned(),
    ))
}

fn feature_options(input: &Input, cameras: &Cameras) -> Result<FeatureOptions, Failure> {
    Ok(FeatureOptions {
        calibration: cameras.initial().map_err(Failure::Usage)?,
        calibration_files: cameras.calibration.clone(),
        cameras: cameras.cameras,
        timestamps: input.timestamps.clone(),
        max_size: input.max_size,
        max_pixels: MEGA * input.max_megapixels,
        ..FeatureOptions::default()
    })
}

fn match_options(pairs: &Pairs, seed: &Seed) -> MatchOptions {
    MatchOptions { pairs: pairs.pairs, seed: seed.seed, ..MatchOptions::default() }
}

fn map_options(mapping: &Mapping, seed: &Seed) -> Result<MapOptions, Failure> {
    let refine_extrinsics = mapping.refine.is_some_and(|refine| refine.extrinsics);
    if refine_extrinsics && mapping.rig_calibration.is_none() {
        return Err(Failure::Usage(
            "--refine extrinsics refines those of --rig-calibration: give both".to_owned(),
        ));
    }
    if mapping.control_points.is_some()
        && matches!(mapping.position_priors, PositionPriors::File(_))
    {
        return Err(Failure::Usage(
            "--control-points gives the frame: leave out the file of --position-priors".to_owned(),
        ));
    }
    Ok(MapOptions {
        mapper: MapperOptions {
            select_camera_models: true,
            rig: mapping.rig,
            readout: mapping.rolling_shutter,
            seed: seed.seed,
            ..MapperOptions::default()
        },
        refine: mapping.refine.map(|refine| refine.intrinsics),
        calibration_sigma_px: mapping.calibration_sigma.map(|PositivePixels(sigma_px)| sigma_px),
        baseline_m: mapping.baseline.map(|Metres(baseline_m)| baseline_m),
        input_model: mapping
            .input_model
            .clone()
            .map(|path| InputModel { path, fix_existing_frames: mapping.fix_existing_frames }),
        rig_calibration: mapping.rig_calibration.clone(),
        refine_extrinsics,
        position_priors: mapping.position_priors.clone(),
        control_points: mapping.control_points.clone(),
        submaps: mapping.submaps,
        max_memory_bytes: mapping.max_memory,
        merges_submaps: false,
    })
}
