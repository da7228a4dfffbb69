//! COLMAP's commands: the calls of 3DGS's `convert.py` and of nerfstudio, a database that another
//! program made, and options.

mod dense;

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

use rusqlite::Connection;
use tiepoint_pipeline::io::colmap::{Format, read_model};
use tiepoint_pipeline::sfm::geometry::nalgebra::Vector3;
use tiepoint_pipeline::workspace::write_model;

use crate::{Run, photos, tiepoint, tiepoint_in};

/// Down in an image.
const Y: Vector3<f64> = Vector3::new(0.0, 1.0, 0.0);
/// Photos of the first call, and of all.
const OLD: usize = 5;
const ALL: usize = 6;

/// A folder with `input` (photos) and what the calls made of them, made once.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let dir = FOLDER.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        photos::write(&dir.path().join("input"), OLD, 0);
        fs::create_dir_all(dir.path().join("distorted/sparse")).unwrap();
        for line in [
            "feature_extractor --database_path {}/distorted/database.db --image_path {}/input \
             --ImageReader.single_camera 1 --ImageReader.camera_model OPENCV \
             --SiftExtraction.use_gpu 1",
            "exhaustive_matcher --database_path {}/distorted/database.db --SiftMatching.use_gpu 1",
            "mapper --database_path {}/distorted/database.db --image_path {}/input --output_path \
             {}/distorted/sparse --Mapper.ba_global_function_tolerance=0.000001",
        ] {
            colmap(dir.path(), line).done();
        }
        dir
    });
    dir.path()
}

/// Runs a verb under the name `colmap` where links exist, as a command elsewhere.
fn colmap(dir: &Path, line: &str) -> Run {
    let program = dir.join("colmap");
    #[cfg(unix)]
    if !program.exists() {
        std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_tiepoint"), &program).unwrap();
    }
    if !program.exists() {
        return tiepoint_in(dir, &format!("colmap {line}"));
    }
    let dir = dir.to_str().unwrap();
    let words = line.split_whitespace().map(|word| word.replace("{}", dir));
    Run(Command::new(program).args(words).output().expect("the program starts"))
}

/// The ids and names of the images of a database.
fn images(database: &Path) -> Vec<(i64, String)> {
    let database = Connection::open(database).unwrap();
    let mut rows = database.prepare("SELECT image_id, name FROM images ORDER BY image_id").unwrap();
    let rows = rows.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    rows.map(Result::unwrap).collect()
}

fn count(database: &Path, table: &str) -> i64 {
    let database = Connection::open(database).unwrap();
    database.query_row(&format!("SELECT count(*) FROM {table}"), [], |row| row.get(0)).unwrap()
}

/// A copy of the folder of all tests.
fn copy() -> tempfile::TempDir {
    let copy = tempfile::tempdir().unwrap();
    for name in ["input", "distorted/sparse/0"] {
        fs::create_dir_all(copy.path().join(name)).unwrap();
        for entry in fs::read_dir(folder().join(name)).unwrap() {
            let from = entry.unwrap().path();
            let to = copy.path().join(name).join(from.file_name().unwrap());
            fs::copy(from, to).unwrap();
        }
    }
    let database = "distorted/database.db";
    fs::copy(folder().join(database), copy.path().join(database)).unwrap();
    copy
}

#[test]
fn calls_of_3dgs_and_nerfstudio_make_what_colmap_makes() {
    let dir = copy();
    let database = dir.path().join("distorted/database.db");
    assert_eq!(count(&database, "cameras"), 1);
    assert_eq!(images(&database).len(), OLD);
    assert_eq!(count(&database, "two_view_geometries"), (OLD * (OLD - 1) / 2) as i64);
    let folder = dir.path().join("distorted/sparse/0");
    let mapped = read_model(&folder).unwrap();
    assert_eq!(mapped.num_registered(), OLD);
    let camera = *mapped.cameras().next().unwrap().1;
    assert_eq!(camera.intrinsics.kind().name(), "OPENCV");
    // The principal point stays where it is by default.
    let centre = [f64::from(camera.width) / 2.0, f64::from(camera.height) / 2.0];
    assert_eq!(camera.intrinsics.params()[2..4], centre);
    assert!(fs::read_to_string(folder.join("project.ini")).unwrap().contains("[Mapper]\n"));
    // In place.
    colmap(
        dir.path(),
        "model_aligner --input_path {}/distorted/sparse/0 --database_path \
         {}/distorted/database.db --alignment_max_error 0.1 --alignment_type plane --output_path \
         {}/distorted/sparse/0",
    )
    .done();
    let aligned = read_model(&folder).unwrap();
    let mean_z = |model: &tiepoint_pipeline::sfm::scene::Reconstruction| {
        model.tracks().map(|(_, track)| track.xyz.z).sum::<f64>() / model.num_tracks() as f64
    };
    assert!(mean_z(&aligned).abs() < 1e-9 && mean_z(&mapped).abs() > 1e-3);
    assert!(aligned.registered().map(|(_, _, pose)| pose.origin_in_a().z).sum::<f64>() > 0.0);
    colmap(
        dir.path(),
        "image_undistorter --image_path {}/input --input_path {}/distorted/sparse/0 --output_path \
         {} --output_type COLMAP",
    )
    .done();
    let made = ["images/0.png", "stereo/patch-match.cfg", "run-colmap-geometric.sh"];
    assert!(made.iter().all(|name| dir.path().join(name).is_file()));
    let undistorted = read_model(&dir.path().join("sparse")).unwrap();
    assert_eq!(undistorted.cameras().next().unwrap().1.intrinsics.kind().name(), "PINHOLE");
    let run = tiepoint_in(
        dir.path(),
        "--json colmap bundle_adjuster --input_path {}/distorted/sparse/0 --output_path \
         {}/distorted/sparse/0 --BundleAdjustment.refine_principal_point 1",
    )
    .done();
    let cost = |name: &str| run.json()[name].as_f64().unwrap();
    assert!(cost("final_cost") < cost("initial_cost"));
    let adjusted = read_model(&folder).unwrap();
    assert_ne!(adjusted.cameras().next().unwrap().1.intrinsics.params()[2..4], centre);
    assert!(adjusted.mean_reprojection_error_px() < 1.0);
}

#[test]
fn undistortion_beside_a_database_can_run_again() {
    let dir = copy();
    let database = dir.path().join("database.db");
    fs::rename(dir.path().join("distorted/database.db"), &database).unwrap();
    fs::write(dir.path().join("images.txt"), "theirs").unwrap();
    let line = "image_undistorter --image_path {}/input --input_path {}/distorted/sparse/0 \
                --output_path {} --output_type COLMAP";
    let before = fs::read(&database).unwrap();
    colmap(dir.path(), line).done();
    let image = dir.path().join("images/0.png");
    let first = fs::read(&image).unwrap();
    colmap(dir.path(), line).done();
    assert_eq!(fs::read(&image).unwrap(), first);
    // As convert.py moves the model, and a caller may change an image.
    fs::create_dir(dir.path().join("sparse/0")).unwrap();
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let model = dir.path().join("sparse");
        fs::rename(model.join(name), model.join("0").join(name)).unwrap();
    }
    colmap(dir.path(), line).done();
    assert!(dir.path().join("sparse/0/images.bin").is_file());
    fs::write(&image, "theirs").unwrap();
    colmap(dir.path(), line).failed(1, &["images/0.png"]);
    assert_eq!(fs::read(&image).unwrap(), b"theirs");
    assert_eq!(fs::read(&database).unwrap(), before);
    // A folder with the database of a workspace, whose list of stages is lost, stays one.
    tiepoint_in(dir.path(), "features {}/input -o {}/ws").done();
    fs::remove_file(dir.path().join("ws/stages.json")).unwrap();
    colmap(dir.path(), &line.replace("--output_path {}", "--output_path {}/ws")).failed(1, &["ws"]);
}

/// Whether COLMAP 3 itself is installed.
fn has_colmap_3() -> bool {
    let help = Command::new("colmap").arg("help").env("QT_QPA_PLATFORM", "offscreen").output();
    let help = help.map(|found| String::from_utf8_lossy(&found.stdout).into_owned());
    help.is_ok_and(|help| help.starts_with("COLMAP 3.") && !help.contains("tiepoint"))
}

/// Runs a verb of COLMAP 3 itself.
fn colmap_3(dir: &Path, line: &str) {
    let words = line.replace("{}", dir.to_str().unwrap());
    let mut command = Command::new("colmap");
    command.args(words.split_whitespace()).env("QT_QPA_PLATFORM", "offscreen");
    let run = Run(command.output().unwrap());
    assert_eq!(run.code(), 0, "{line}: {} {}", run.stdout(), run.stderr());
}

/// COLMAP 3 reads columns by their place, and has no rigs.
#[test]
fn colmap_3_maps_matches_and_registers_from_our_database() {
    if !has_colmap_3() {
        return crate::skipped::skipped("COLMAP 3 (`colmap`)");
    }
    let dir = copy();
    let theirs = |line: &str| colmap_3(dir.path(), line);
    let database = dir.path().join("distorted/database.db");
    fs::create_dir_all(dir.path().join("theirs/all")).unwrap();
    theirs(
        "mapper --database_path {}/distorted/database.db --image_path {}/input --output_path \
         {}/theirs --Mapper.num_threads 1",
    );
    let model = read_model(&dir.path().join("theirs/0")).unwrap();
    assert_eq!(model.num_registered(), OLD);
    assert!(model.mean_reprojection_error_px() < 1.0);
    // A photo that our program adds, and their matcher matches.
    photos::write(&dir.path().join("input"), ALL, 0);
    let ours = "feature_extractor --database_path {}/distorted/database.db --image_path {}/input \
                --ImageReader.existing_camera_id 1";
    colmap(dir.path(), ours).done();
    theirs(
        "exhaustive_matcher --database_path {}/distorted/database.db --SiftMatching.use_gpu 0 \
         --SiftMatching.num_threads 2",
    );
    assert_eq!(count(&database, "two_view_geometries"), (ALL * (ALL - 1) / 2) as i64);
    theirs(
        "image_registrator --database_path {}/distorted/database.db --input_path {}/theirs/0 \
         --output_path {}/theirs/all",
    );
    assert_eq!(read_model(&dir.path().join("theirs/all")).unwrap().num_registered(), ALL);
    // They left their version in it, and our mapper still reads it.
    let ours = "mapper --database_path {}/distorted/database.db --image_path {}/input \
                --output_path {}/ours";
    colmap(dir.path(), ours).done();
    assert_eq!(read_model(&dir.path().join("ours/0")).unwrap().num_registered(), ALL);
}

#[test]
fn a_database_is_added_to_and_keeps_what_it_has() {
    let dir = copy();
    let database = dir.path().join("distorted/database.db");
    // As COLMAP 3.8 made it: no rigs, all descriptors SIFT; and an id that is not given again.
    let old = Connection::open(&database).unwrap();
    old.execute_batch(
        "DROP TABLE frame_data; DROP TABLE frames; DROP TABLE rig_sensors; DROP TABLE rigs; \
         ALTER TABLE descriptors DROP COLUMN type; UPDATE sqlite_sequence SET seq = 40 WHERE name \
         = 'images';",
    )
    .unwrap();
    old.close().unwrap();
    let before = images(&database);
    let keypoints = |id: i64| -> Vec<u8> {
        let database = Connection::open(&database).unwrap();
        let sql = "SELECT data FROM keypoints WHERE image_id = ?1";
        database.query_row(sql, [id], |row| row.get(0)).unwrap()
    };
    let first = keypoints(1);
    photos::write(&dir.path().join("input"), ALL, 0);
    let line = "feature_extractor --database_path {}/distorted/database.db --image_path {}/input \
                --ImageReader.existing_camera_id 1";
    let run = tiepoint_in(dir.path(), &format!("--json colmap {line}")).done();
    assert_eq!((run.json()["images"].as_u64(), run.json()["kept"].as_u64()), (Some(1), Some(5)));
    let after = images(&database);
    assert_eq!(after[..OLD], before);
    assert_eq!(after[OLD], (41, format!("{OLD}.png")));
    assert_eq!((count(&database, "cameras"), keypoints(1)), (1, first));
    let line = "sequential_matcher --database_path {}/distorted/database.db \
                --SequentialMatching.overlap 10 --FeatureMatching.use_gpu=0";
    colmap(dir.path(), line).done();
    assert_eq!(count(&database, "matches"), (ALL * (ALL - 1) / 2) as i64);
    let line = "image_registrator --database_path {}/distorted/database.db --input_path \
                {}/distorted/sparse/0 --output_path {}/all";
    colmap(dir.path(), line).done();
    let [old, all] = ["distorted/sparse/0", "all"].map(|name| {
        let model = read_model(&dir.path().join(name)).unwrap();
        model.registered().map(|(id, _, pose)| (id, *pose)).collect::<Vec<_>>()
    });
    assert_eq!(all[..OLD], old);
    assert_eq!(all.len(), ALL);
    let line = "point_triangulator --database_path {}/distorted/database.db --image_path \
                {}/input --input_path {}/all --output_path {}/points";
    colmap(dir.path(), line).done();
    let model = read_model(&dir.path().join("points")).unwrap();
    assert_eq!(model.registered().map(|(id, _, pose)| (id, *pose)).collect::<Vec<_>>(), all);
    assert_eq!(model.original_ids.image(model.registered().last().unwrap().0), 41);
    assert!(model.num_tracks() > 100 && model.mean_reprojection_error_px() < 1.0);
}

#[test]
fn models_are_counted_and_converted() {
    let dir = copy();
    let text = colmap(dir.path(), "model_analyzer --path {}/distorted/sparse/0").done().stdout();
    assert!(text.contains(&format!("Registered images: {OLD}\n")), "{text}");
    let line = "model_converter --input_path {}/distorted/sparse/0 --output_path";
    colmap(dir.path(), &format!("{line} {{}}/text --output_type TXT")).done();
    let binary = read_model(&dir.path().join("distorted/sparse/0")).unwrap();
    let text = read_model(&dir.path().join("text")).unwrap();
    assert_eq!(text.num_tracks(), binary.num_tracks());
    // In place, beside the model of the other format.
    let images = dir.path().join("distorted/sparse/0/images.bin");
    let before = fs::read(&images).unwrap();
    colmap(dir.path(), &format!("{line} {{}}/distorted/sparse/0 --output_type TXT")).done();
    assert!(images.with_extension("txt").is_file());
    assert_eq!(fs::read(&images).unwrap(), before);
    colmap(dir.path(), &format!("{line} {{}}/points.ply --output_type PLY")).done();
    assert!(dir.path().join("points.ply").is_file());
    colmap(dir.path(), &format!("{line} {{}}/x --output_type NVM")).failed(1, &["NVM", "PLY"]);
}

#[test]
fn options_are_those_of_colmap() {
    let first = |run: Run| run.done().stdout().lines().next().unwrap().to_owned();
    let line = first(tiepoint(["colmap", "-h"]));
    let version = line.strip_prefix("COLMAP ").unwrap().split(' ').next().unwrap();
    assert!(version.split('.').all(|part| part.parse::<u32>().is_ok()), "{line}");
    assert!(line.contains("tiepoint"), "{line}");
    for words in [&["help"][..], &["version"], &[], &["mapper", "--help"]] {
        assert_eq!(first(tiepoint([&["colmap"], words].concat())), line);
    }
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("empty")).unwrap();
    let run = |line: &str| tiepoint_in(dir.path(), &format!("colmap {line}"));
    run("stereo_fuser").failed(1, &["stereo_fuser", "colmap help"]);
    run("mapper --Mapper.unknown 1").failed(1, &["--Mapper.unknown", "colmap mapper -h"]);
    run("mapper --Mapper.use_prior_position 1").failed(1, &["use_prior_position"]);
    run("mapper --Mapper.min_model_size many").failed(1, &["min_model_size", "whole number"]);
    run("mapper --Mapper.num_threads").failed(1, &["num_threads has no value"]);
    run("mapper").failed(1, &["--database_path"]);
    let files = "--database_path {}/no.db --image_path {}/empty --output_path {}/out";
    for (option, name) in [
        ("ba_local_num_images 0", "ba_local_num_images"),
        ("ba_global_images_ratio 0.5", "ba_global_images_ratio"),
        ("tri_min_angle -1", "tri_min_angle"),
        ("filter_max_reproj_error nan", "filter_max_reproj_error"),
    ] {
        run(&format!("mapper {files} --Mapper.{option}")).failed(1, &["--Mapper.", name]);
    }
    let line = "feature_extractor --database_path {}/x.db --image_path {}/empty";
    run(line).failed(1, &["empty", "no images"]);
    let tuned = run(&format!("{line} --FeatureExtraction.use_gpu true --log_level=0"));
    assert_eq!(tuned.stderr().lines().count(), 1, "{}", tuned.stderr());
    // The options of a project file, which has those of all verbs.
    fs::write(dir.path().join("a.ini"), "image_path=nowhere\n[Mapper]\nnum_threads=1\n").unwrap();
    let line = "feature_extractor --database_path {}/x.db --project_path {}/a.ini";
    run(line).failed(1, &["nowhere"]);
    assert!(!dir.path().join("x.db").exists());
}

#[test]
fn a_model_of_another_program_is_not_replaced_by_the_mapper() {
    let dir = copy();
    let folder = dir.path().join("theirs/0");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("cameras.bin"), "theirs").unwrap();
    let line = "mapper --database_path {}/distorted/database.db --image_path {}/input \
                --output_path {}/theirs";
    colmap(dir.path(), line).failed(1, &["cameras.bin"]);
    assert_eq!(fs::read(folder.join("cameras.bin")).unwrap(), b"theirs");
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
    // A workspace's database has records, which would become wrong.
    tiepoint_in(dir.path(), "features {}/input -o {}/ws").done();
    let line = "exhaustive_matcher --database_path {}/ws/database.db";
    colmap(dir.path(), line).failed(1, &["ws/database.db", "tiepoint match"]);
}

#[test]
fn results_of_a_workspace_are_no_output_folder() {
    let dir = copy();
    let dir = dir.path();
    tiepoint_in(dir, "reconstruct {}/input -o {}/ws").done();
    let model = "--input_path {}/distorted/sparse/0";
    let database = "--database_path {}/distorted/database.db --image_path {}/input";
    for line in [
        format!("bundle_adjuster {model} --output_path {{}}/ws/sparse/0"),
        format!("model_aligner {model} --alignment_type plane --output_path {{}}/ws/sparse/0"),
        format!("model_converter {model} --output_type TXT --output_path {{}}/ws/sparse/0"),
        format!("mapper {database} --output_path {{}}/ws/sparse"),
        format!("mapper {database} {model} --output_path {{}}/ws/sparse/7"),
        format!("point_triangulator {database} {model} --output_path {{}}/ws/sparse/0"),
        format!("image_undistorter --image_path {{}}/input {model} --output_path {{}}/ws/dense"),
    ] {
        colmap(dir, &line).failed(1, &["ws is a workspace", "another folder"]);
    }
    for line in [
        "adjust {}/distorted/sparse/0 -o {}/ws",
        "export {}/ws --to colmap -o {}/ws",
        "model crop {}/ws --quantiles 0.1,0.9 -o {}/ws",
    ] {
        tiepoint_in(dir, line).failed(1, &["ws is a workspace"]);
    }
    for line in [
        "undistort {}/distorted/sparse/0 --images {}/input -o {}/distorted/sparse/0",
        "undistort {}/distorted/sparse/0/ --images {}/input -o {}/distorted/../distorted/sparse/0",
    ] {
        tiepoint_in(dir, line).failed(1, &["sparse/0 is read by this command"]);
    }
    // The records are true.
    tiepoint_in(dir, "map {}/ws").done();
    // A folder of one's own in a workspace is none of its results.
    colmap(dir, &format!("bundle_adjuster {model} --output_path {{}}/ws/mine")).done();
}

#[test]
fn models_of_a_mapper_are_replaced_together() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    // Photos of two rooms: two models.
    photos::write(&dir.join("photos/a"), 4, 0);
    photos::write(&dir.join("photos/b"), 4, 77);
    let database = "--database_path {}/x.db";
    colmap(dir, &format!("feature_extractor {database} --image_path {{}}/photos")).done();
    colmap(dir, &format!("exhaustive_matcher {database}")).done();
    let mapper = format!(
        "mapper {database} --image_path {{}}/photos --output_path {{}}/out \
         --Mapper.min_model_size 3"
    );
    colmap(dir, &mapper).done();
    let bytes = |name: &str| fs::read(dir.join("out").join(name)).ok();
    let second = bytes("1/images.bin").expect("two models");
    // A model that is not there any more is removed, one that was adjusted in place is replaced.
    let adjust = "bundle_adjuster --input_path {}/out/0 --output_path {}/out/0";
    colmap(dir, adjust).done();
    // What another command wrote beside them stays.
    tiepoint_in(dir, "export {}/out/0 --to colmap-text -o {}/out").done();
    colmap(dir, &format!("{mapper} --Mapper.max_num_models 1")).done();
    assert!(bytes("0/images.bin").is_some() && bytes("1/images.bin").is_none());
    assert!(bytes("images.txt").is_some());
    colmap(dir, &mapper).done();
    assert_eq!(bytes("1/images.bin").as_ref(), Some(&second));
    // A foreign model is refused before the work, whatever its number.
    fs::write(dir.join("out/1/points3D.bin"), "theirs").unwrap();
    let first = bytes("0/images.bin");
    colmap(dir, &format!("{mapper} --Mapper.ba_refine_focal_length 0"))
        .failed(1, &["out/1/points3D.bin", "did not make it"]);
    assert_eq!((bytes("0/images.bin"), bytes("1/images.bin")), (first, Some(second)));
}

/// The calls of beginners' scripts: one command, its model with up along −y, and colours.
#[test]
fn automatic_reconstructor_gives_a_model_that_other_verbs_take() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), OLD, 0);
    let line = "automatic_reconstructor --workspace_path {}/ws --image_path {}/photos --dense 0 \
                --quality medium --data_type video";
    let said = colmap(dir, line).done().stdout();
    assert!(said.contains(&format!("all {OLD} images have a pose")), "{said}");
    let model = read_model(&dir.join("ws/sparse/0")).unwrap();
    for (quality, part) in [("fine", "no quality fine"), ("low", "1000")] {
        let line = format!(
            "automatic_reconstructor --workspace_path {{}}/ws --image_path {{}}/photos --dense 0 \
             --quality {quality}"
        );
        colmap(dir, &line).failed(1, &[part]);
    }
    let aligner = "model_orientation_aligner --input_path {}/ws/sparse/0 --output_path {}/up";
    colmap(dir, aligner).failed(1, &["MANHATTAN-WORLD", "IMAGE-ORIENTATION"]);
    colmap(dir, &format!("{aligner} --method IMAGE-ORIENTATION")).done();
    let upright = read_model(&dir.join("up")).unwrap();
    let down: Vec<f64> =
        upright.registered().map(|(.., pose)| pose.rotation.inverse() * Y).map(|y| y.y).collect();
    assert!(down.iter().sum::<f64>() > 0.9 * OLD as f64, "{down:?}");
    assert_eq!(upright.num_tracks(), model.num_tracks());
    // Points without colours get those of the photos.
    let colors = |folder: &str| -> Vec<[u8; 3]> {
        read_model(&dir.join(folder)).unwrap().tracks().map(|(_, track)| track.color).collect()
    };
    let before = colors("up");
    let mut grey = upright;
    let points: Vec<_> = grey.tracks().map(|(id, _)| id).collect();
    points.into_iter().for_each(|id| grey.track_mut(id).unwrap().color = [0; 3]);
    write_model(&dir.join("grey"), &grey, Format::Binary).unwrap();
    let line = "color_extractor --image_path {}/photos --input_path {}/grey --output_path {}/new";
    colmap(dir, line).done();
    assert_eq!(colors("new"), before);
}

#[test]
fn databases_are_created_once_and_other_verbs_name_what_serves_instead() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    colmap(dir, "database_creator --database_path {}/a.db").done();
    let before = fs::read(dir.join("a.db")).unwrap();
    colmap(dir, "database_creator --database_path {}/a.db").done();
    assert!(fs::read(dir.join("a.db")).unwrap() == before);
    assert!(images(&dir.join("a.db")).is_empty());
    fs::write(dir.join("mine"), "mine").unwrap();
    colmap(dir, "database_creator --database_path {}/mine").failed(1, &["mine"]);
    colmap(dir, "delaunay_mesher").failed(1, &["no delaunay_mesher", "stereo_fusion"]);
    colmap(dir, "poisson_mesher").failed(1, &["no poisson_mesher", "fused.ply"]);
    colmap(dir, "mapperr").failed(1, &["no command mapperr", "colmap help"]);
}

#[test]
fn features_of_a_photo_that_has_another_size_now_are_not_taken_for_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), 2, 0);
    let line = "feature_extractor --database_path {}/x.db --image_path {}/photos";
    colmap(dir, line).done();
    let again = colmap(dir, line).done();
    assert!(
        again.stdout().contains("2 images had features before, 0 skipped"),
        "{}",
        again.stdout()
    );
    image::RgbImage::new(64, 48).save(dir.join("photos/1.png")).unwrap();
    let again = colmap(dir, line).done();
    assert!(
        again.stdout().contains("1 images had features before, 1 skipped"),
        "{}",
        again.stdout()
    );
    let said = again.stderr();
    assert!(said.contains("1.png: has 64 x 48 pixels, and the features of this name"), "{said}");
}
