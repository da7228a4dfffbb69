//! `colmap patch_match_stereo` and `colmap stereo_fusion`: dense workspaces of both programs.

use std::fs;
use std::path::{Path, PathBuf};

use tiepoint_pipeline::io::dense::DenseMap;
use tiepoint_pipeline::io::ply;

use super::{colmap, colmap_3, copy, has_colmap_3};
use crate::dense::copy_folder;
use crate::{photos, tiepoint_in};

/// Width of the depth maps of all tests, in pixels: a third of the photos'.
const SIZE: usize = 112;
/// Fewest points of a cloud: the walls fill most of five images of 112 × 84 pixels, and COLMAP
/// makes a point of about twenty of them.
const MIN_POINTS: usize = 1_000;
/// Distance within which a point of another cloud is the same surface, in extents of the cloud: two
/// pixels in an image of this size, the distance of COLMAP's points from each other, which merges
/// pixels up to two from another.
const NEAR: f64 = 2.0 / SIZE as f64;
/// Share of COLMAP's points that lie on our cloud, and of ours on COLMAP's, which asks for more
/// pixels at the borders: 1.00 and 0.91 are measured.
const MIN_THEIRS_ON_OURS: f64 = 0.97;
const MIN_OURS_ON_THEIRS: f64 = 0.8;

const STEREO: &str = "patch_match_stereo --workspace_path {}/dense --workspace_format COLMAP \
                      --PatchMatchStereo.geom_consistency true";
const FUSION: &str = "stereo_fusion --workspace_path {}/dense --workspace_format COLMAP \
                      --input_type geometric --output_path {}/dense/fused.ply";

/// A folder with a dense workspace that `image_undistorter` made.
fn undistorted() -> tempfile::TempDir {
    let dir = copy();
    let line = "image_undistorter --image_path {}/input --input_path {}/distorted/sparse/0 \
                --output_path {}/dense --output_type COLMAP";
    colmap(dir.path(), line).done();
    dir
}

fn map(dir: &Path, kind: &str, image: &str) -> PathBuf {
    dir.join(format!("dense/stereo/{kind}_maps/{image}.png.geometric.bin"))
}

/// Positions of a cloud.
fn points(path: &Path) -> Vec<[f64; 3]> {
    ply::read(path).unwrap().iter().map(|point| point.xyz.into()).collect()
}

/// Share of the points of a cloud that have one of the other near them.
fn share_near(points: &[[f64; 3]], others: &[[f64; 3]]) -> f64 {
    let extent = |axis: usize| {
        let all = || points.iter().map(|point| point[axis]);
        all().fold(f64::MIN, f64::max) - all().fold(f64::MAX, f64::min)
    };
    let near = NEAR * (0..3).map(extent).fold(0.0, f64::max);
    let cell = |point: &[f64; 3]| point.map(|value| (value / near).floor() as i64);
    let mut cells = std::collections::BTreeMap::<[i64; 3], Vec<[f64; 3]>>::new();
    others.iter().for_each(|point| cells.entry(cell(point)).or_default().push(*point));
    let steps = || -1..=1;
    let is_near = |point: &&[f64; 3]| {
        let [x, y, z] = cell(point);
        let around =
            steps().flat_map(|i| steps().flat_map(move |j| steps().map(move |k| [i, j, k])));
        around.filter_map(|[i, j, k]| cells.get(&[x + i, y + j, z + k])).flatten().any(|other| {
            (0..3).map(|axis| (other[axis] - point[axis]).powi(2)).sum::<f64>() < near * near
        })
    };
    points.iter().filter(is_near).count() as f64 / points.len() as f64
}

/// The same images, model and sources give the same bytes as the stage `dense`.
#[test]
fn the_verbs_do_what_the_stage_does() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    photos::write(&dir.join("photos"), 4, 0);
    tiepoint_in(dir, "reconstruct {}/photos -o {}/ws").done();
    tiepoint_in(dir, &format!("dense {{}}/ws --max-size {SIZE} --normal-maps")).done();
    for folder in ["images", "sparse"] {
        copy_folder(&dir.join("ws/dense").join(folder), &dir.join("dense").join(folder));
    }
    fs::create_dir(dir.join("dense/stereo")).unwrap();
    for list in ["patch-match.cfg", "fusion.cfg"] {
        fs::copy(dir.join("ws/dense/stereo").join(list), dir.join("dense/stereo").join(list))
            .unwrap();
    }
    colmap(dir, STEREO).done();
    // Half and twice of COLMAP's tolerance are near; the stage has half.
    colmap(dir, &format!("{FUSION} --StereoFusion.max_reproj_error 1")).done();
    for kind in ["depth", "normal", "confidence"] {
        for image in 0..4 {
            let theirs = map(&dir.join("ws"), kind, &image.to_string());
            let ours = map(dir, kind, &image.to_string());
            assert!(fs::read(ours).unwrap() == fs::read(theirs).unwrap(), "{kind} {image}");
        }
    }
    for name in ["fused.ply", "fused.ply.vis"] {
        let [ours, theirs] = ["dense", "ws/dense"].map(|folder| dir.join(folder).join(name));
        assert!(fs::read(ours).unwrap() == fs::read(theirs).unwrap(), "{name}");
    }
    // The results of a workspace are its own.
    colmap(dir, &STEREO.replace("{}/dense", "{}/ws/dense")).failed(1, &["ws is a workspace"]);
    let into = FUSION.replace("{}/dense", "{}/ws/dense");
    colmap(dir, &into).failed(1, &["ws is a workspace"]);
}

#[test]
fn a_script_of_colmap_gets_a_dense_cloud_and_goes_on() {
    let dir = undistorted();
    let dir = dir.path();
    let stereo = format!("{STEREO} --PatchMatchStereo.max_image_size {SIZE}");
    colmap(dir, FUSION).failed(1, &["depth_maps", "patch_match_stereo first"]);
    let made = |line: &str| {
        let run = tiepoint_in(dir, &format!("--json colmap {line}")).done().json();
        ["depth_maps", "kept"].map(|key| run[key].as_u64().unwrap())
    };
    assert_eq!(made(&stereo), [5, 0]);
    let depths = DenseMap::read(&map(dir, "depth", "0")).unwrap();
    assert_eq!((depths.width, depths.channels), (SIZE, 1));
    assert_eq!(DenseMap::read(&map(dir, "normal", "0")).unwrap().channels, 3);
    assert!(!dir.join("dense/stereo/planes").exists());
    let run = tiepoint_in(dir, &format!("--json colmap {FUSION}")).done().json();
    let all = points(&dir.join("dense/fused.ply"));
    assert_eq!(run["points"].as_u64(), Some(all.len() as u64));
    assert!(all.len() > MIN_POINTS, "{}", all.len());
    // A map that is lost comes back; maps of other sources or another size do not stay.
    let first = fs::read(map(dir, "depth", "0")).unwrap();
    fs::remove_file(map(dir, "depth", "0")).unwrap();
    assert_eq!(made(&stereo), [5, 4]);
    assert!(fs::read(map(dir, "depth", "0")).unwrap() == first);
    fs::write(dir.join("some.cfg"), "0.png\n1.png, 3.png\n2.png\n__auto__, 20\n").unwrap();
    assert_eq!(made(&format!("{stereo} --config_path {{}}/some.cfg")), [2, 1]);
    assert!(fs::read(map(dir, "depth", "0")).unwrap() != first);
    assert!(map(dir, "depth", "4").is_file());
    assert_eq!(made(&format!("{STEREO} --PatchMatchStereo.max_image_size 80")), [5, 0]);
    // Points of a box, of photos with masks, and from fewer images.
    let count = |options: &str| {
        let run = tiepoint_in(dir, &format!("--json colmap {FUSION} {options}")).done().json();
        run["points"].as_u64().unwrap()
    };
    let all = count("");
    assert!(count("--StereoFusion.min_num_pixels 2") > all);
    fs::write(dir.join("box.txt"), "-1e9 -1e9 -1e9\n1e9 1e9 -1e8\n").unwrap();
    assert_eq!(count("--bbox_path {}/box.txt"), 0);
    fs::create_dir(dir.join("masks")).unwrap();
    for image in 0..5 {
        let (width, height) = image::image_dimensions(dir.join("dense/images/0.png")).unwrap();
        let mask = image::GrayImage::from_fn(width, height, |x, _| {
            image::Luma([if x < width / 2 { 0 } else { 255 }])
        });
        mask.save(dir.join(format!("masks/{image}.png.png"))).unwrap();
    }
    let masked = count("--StereoFusion.mask_path {}/masks");
    assert!(masked > 0 && masked < 3 * all / 4, "{masked} of {all}");
    // Photometric maps are the same ones.
    let photometric = stereo.replace("consistency true", "consistency 0");
    assert_eq!(made(&photometric), [5, 0]);
    let name = map(dir, "depth", "0").to_str().unwrap().replace("geometric", "photometric");
    assert!(fs::read(name).unwrap() == first);
    assert!(map(dir, "depth", "0").is_file());
    assert_eq!(count("--input_type photometric"), run["points"].as_u64().unwrap());
}

#[test]
fn files_of_others_stay_and_bad_ones_are_named() {
    let dir = undistorted();
    let dir = dir.path();
    let stereo = format!("{STEREO} --PatchMatchStereo.max_image_size {SIZE}");
    let theirs = map(dir, "depth", "3");
    fs::write(&theirs, "theirs").unwrap();
    colmap(dir, &stereo).failed(1, &["3.png.geometric.bin", "did not make it"]);
    assert_eq!(fs::read(&theirs).unwrap(), b"theirs");
    assert!(!map(dir, "depth", "0").exists());
    colmap(dir, FUSION).failed(1, &["3.png.geometric.bin"]);
    fs::remove_file(&theirs).unwrap();
    for (option, part) in [
        ("PatchMatchStereo.depth_min 1", "depth_min"),
        ("workspace_format PMVS", "PMVS"),
        ("PatchMatchStereo.write_consistency_graph 1", "consistency_graph"),
        ("config_path {}/none.cfg", "none.cfg"),
    ] {
        colmap(dir, &format!("{stereo} --{option}")).failed(1, &[part]);
    }
    let list = dir.join("dense/stereo/patch-match.cfg");
    let lists = fs::read(&list).unwrap();
    fs::write(&list, "0.png\n9.png\n").unwrap();
    colmap(dir, &stereo).failed(1, &["patch-match.cfg: line 2", "9.png"]);
    fs::write(&list, lists).unwrap();
    colmap(dir, &stereo).done();
    // A cloud of another program.
    let cloud = dir.join("dense/fused.ply");
    fs::write(&cloud, "theirs").unwrap();
    colmap(dir, FUSION).failed(1, &["fused.ply", "--overwrite"]);
    assert_eq!(fs::read(&cloud).unwrap(), b"theirs");
    colmap(dir, &format!("{FUSION} --overwrite 1")).done();
    let with_confidences = fs::read(&cloud).unwrap();
    for (option, part) in [
        ("StereoFusion.max_image_size 90", "--PatchMatchStereo.max_image_size 90"),
        ("StereoFusion.min_num_pixels 0", "min_num_pixels"),
        ("input_type depth", "photometric"),
        ("bbox_path {}/dense/stereo/fusion.cfg", "six numbers"),
        ("output_type BIN", "output_type"),
    ] {
        colmap(dir, &format!("{FUSION} --{option}")).failed(1, &[part]);
    }
    // Depths that are no numbers, as in a damaged file, give no point.
    let path = map(dir, "depth", "0");
    let mut depths = DenseMap::read(&path).unwrap();
    let (whole, values) = (fs::read(&path).unwrap(), depths.values.len());
    let odd = [f32::NAN, f32::INFINITY, -1.0, f32::MAX, f32::MIN_POSITIVE];
    depths.values = odd.iter().copied().cycle().take(values).collect();
    fs::remove_file(&path).unwrap();
    depths.write(&path).unwrap();
    colmap(dir, FUSION).done();
    let is_finite = |point: &[f64; 3]| point.iter().all(|value| value.is_finite());
    assert!(points(&cloud).iter().all(is_finite));
    for (bytes, part) in [
        (&whole[..whole.len() / 2], "numbers"),
        (b"2&80&1&".as_slice(), "numbers"),
        (b"1&2&1&12345678", "another shape"),
        (b"0&0&1&", "another shape"),
    ] {
        fs::write(&path, bytes).unwrap();
        colmap(dir, FUSION).failed(1, &["0.png.geometric.bin", part]);
    }
    fs::write(&path, whole).unwrap();
    colmap(dir, FUSION).done();
    assert!(fs::read(&cloud).unwrap() == with_confidences);
    // Without confidences, as COLMAP's maps are: the same points.
    fs::remove_dir_all(dir.join("dense/stereo/confidence_maps")).unwrap();
    let before = points(&cloud);
    colmap(dir, FUSION).done();
    assert_eq!(points(&cloud), before);
    assert!(!String::from_utf8_lossy(&fs::read(&cloud).unwrap()[..400]).contains("confidence"));
    // Images that are not undistorted.
    fs::remove_dir_all(dir.join("dense/sparse")).unwrap();
    copy_folder(&dir.join("distorted/sparse/0"), &dir.join("dense/sparse"));
    for line in [&stereo, FUSION] {
        colmap(dir, line).failed(1, &["OPENCV", "undistort first"]);
    }
}

/// COLMAP's program fuses our maps to the surface that ours makes of them.
#[test]
fn colmap_3_fuses_our_maps() {
    if !has_colmap_3() {
        return crate::skipped::skipped("COLMAP 3 (`colmap`)");
    }
    let dir = undistorted();
    let dir = dir.path();
    colmap(dir, &format!("{STEREO} --PatchMatchStereo.max_image_size {SIZE}")).done();
    colmap(dir, FUSION).done();
    colmap_3(
        dir,
        "stereo_fusion --workspace_path {}/dense --output_path {}/theirs.ply \
         --StereoFusion.num_threads 1 --StereoFusion.max_normal_error 30",
    );
    let (ours, theirs) = (points(&dir.join("dense/fused.ply")), points(&dir.join("theirs.ply")));
    assert!(theirs.len() > MIN_POINTS, "{}", theirs.len());
    let (on_ours, on_theirs) = (share_near(&theirs, &ours), share_near(&ours, &theirs));
    assert!(on_ours > MIN_THEIRS_ON_OURS, "{on_ours}");
    assert!(on_theirs > MIN_OURS_ON_THEIRS, "{on_theirs}");
}
