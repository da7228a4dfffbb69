//! What control points do to a model: `cargo run --release -p tiepoint-pipeline --example
//! control_points -- [--seeds 8] [--control 4] [--marks 3] [--survey 0.01] [--only errors|wrong]
//! [--write FOLDER]`.
//!
//! A model of keypoints is what images alone give. It is brought to the control points by a
//! similarity, or adjusted together with them. The lens of the model is the true one, or it is off
//! and bends the model. Each line is the root mean square distance over the check points of all
//! seeds: by their marks, which have noise as those of the control points; by their true pixels,
//! which is the error of the model; and the Cramér-Rao bound of both (NaN where a variable of the
//! problem is undetermined). Then one control point is off by 0.3, 1 or 3 m, or one mark by 60 px:
//! how often it is named, how often it is one of several that may be wrong, how many right ones are
//! named, and the errors that are detected and attributed in 80 % of cases.
//! `--write FOLDER` writes the models with a wrong lens before and after, and the points, for a
//! second opinion (`bench/positions.py points --ceres`).

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use tiepoint_pipeline::io::colmap::{Format, write_model};
use tiepoint_pipeline::sfm::adjust::{
    AdjustOptions, Error, Gauge, Mark, RefineIntrinsics, Scope, Term, TermContext, Variables,
    adjust, build_problem, keep_going, relative_noise,
};
use tiepoint_pipeline::sfm::ba::factors::Prior;
use tiepoint_pipeline::sfm::ba::{self, AnyKey, Key};
use tiepoint_pipeline::sfm::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_pipeline::sfm::geometry::numeric::median;
use tiepoint_pipeline::sfm::geometry::{CameraModelKind, Intrinsics, Loss, Rng};
use tiepoint_pipeline::sfm::positions::{
    MarkedPoint, PointError, adjust_to_points, align_to_points, first_similarity_to_points,
    point_errors,
};
use tiepoint_pipeline::sfm::scene::{Image, ImageId, Reconstruction};
use tiepoint_synth::trajectory::{Carrier, Motion};
use tiepoint_synth::{
    Drive, DriveOptions, FeatureOptions, FeatureScene, Mount, RouteKind, SurveyedPoint,
    ViewDirection, surveyed_points,
};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

const NUM_CHECK: usize = 20;
const MIN_MARKS: usize = 5;
/// Images with fewer points have no pose, as after mapping: the first and the last ones of the
/// drive have one to three, which do not determine it.
const MIN_IMAGE_POINTS: usize = 15;
/// What a wrong point and a wrong mark are off by.
const WRONG_M: [f64; 3] = [0.3, 1.0, 3.0];
const WRONG_PX: f64 = 60.0;
/// How far a wrong lens is off: the share of the focal length at half a focal length from the
/// middle is an eighth of it.
const RADIAL: f64 = 0.02;

#[derive(Clone, Copy)]
struct Scene {
    name: &'static str,
    carrier: Carrier,
    length_m: f64,
    width: u32,
    height: u32,
    rate_hz: f64,
    observations: usize,
}

const SCENES: [Scene; 2] = [
    Scene {
        name: "strips from the air, 12 MP",
        carrier: Carrier::Drone,
        length_m: 150.0,
        width: 4000,
        height: 3000,
        rate_hz: 0.5,
        observations: 60_000,
    },
    Scene {
        name: "drive of 150 m, 5 MP",
        carrier: Carrier::Car,
        length_m: 150.0,
        width: 2560,
        height: 1920,
        rate_hz: 3.0,
        observations: 60_000,
    },
];

impl Scene {
    fn truth(&self, seed: u64) -> Outcome<Reconstruction> {
        let drive = Drive::new(&DriveOptions {
            seed,
            route: RouteKind::Open,
            length_m: self.length_m,
            motion: Motion::of(self.carrier),
            mounts: vec![Mount::stereo(ViewDirection::Front, 0.5)[0].clone()],
            width: self.width,
            height: self.height,
            rate_hz: self.rate_hz,
            ..DriveOptions::default()
        })?;
        let features =
            FeatureOptions { seed, observations: self.observations, ..FeatureOptions::default() };
        let mut truth = FeatureScene::new(&drive, &features)?.truth().clone();
        let few = |image: &Image| image.num_points() < MIN_IMAGE_POINTS;
        let few: Vec<ImageId> =
            truth.registered().filter(|(_, image, _)| few(image)).map(|(id, ..)| id).collect();
        few.into_iter().for_each(|image| truth.deregister(image));
        Ok(truth)
    }
}

/// Number of control points, and deviations of the survey and of the marks.
#[derive(Clone, Copy)]
struct Survey {
    num_control: usize,
    survey_m: f64,
    mark_px: f64,
}

impl Survey {
    fn measured(self, points: &[SurveyedPoint], seed: u64) -> Vec<MarkedPoint> {
        let mut rng = Rng::stream(seed, &[40]);
        let measured = points.iter().enumerate().map(|(index, point)| {
            let is_check = index >= self.num_control;
            // Check points are exact, so that their errors are those of the model.
            let sigma_m = if is_check { 0.0 } else { self.survey_m };
            let mut noisy = |(image, pixel): &(ImageId, Vector2<f64>)| {
                (*image, pixel.map(|value| value + self.mark_px * rng.normal()))
            };
            let marks = point.marks.iter().map(&mut noisy).collect();
            MarkedPoint {
                xyz: point.xyz.map(|value| value + sigma_m * rng.normal()),
                sigmas_m: Vector3::repeat(self.survey_m),
                is_check,
                mark_sigma_px: self.mark_px,
                marks,
            }
        });
        measured.collect()
    }
}

/// The check points by their true pixels.
fn exact(points: &[SurveyedPoint], num_control: usize) -> Vec<MarkedPoint> {
    let exact = |point: &SurveyedPoint| MarkedPoint {
        xyz: point.xyz,
        sigmas_m: Vector3::repeat(1e-3),
        is_check: true,
        mark_sigma_px: 3.0,
        marks: point.marks.clone(),
    };
    points.iter().skip(num_control).map(exact).collect()
}

/// The model that images alone give with a fixed lens.
fn of_images(truth: &Reconstruction, radial: f64) -> Outcome<Reconstruction> {
    let mut model = truth.clone();
    for (camera, _) in truth.cameras() {
        let intrinsics = &mut model.camera_mut(camera).intrinsics;
        let centre = intrinsics.principal_point();
        let params = [intrinsics.mean_focal_px(), centre.x, centre.y, radial];
        *intrinsics = Intrinsics::new(CameraModelKind::SimpleRadial, &params)?;
    }
    let options = AdjustOptions {
        refine: RefineIntrinsics::NONE,
        max_iterations: 100,
        ..AdjustOptions::default()
    };
    adjust(&mut model, &Scope::Global, &options, &mut [], &mut keep_going)?;
    Ok(model)
}

fn options(model: &Reconstruction, refine: RefineIntrinsics) -> AdjustOptions<'static> {
    let gauge = Gauge::FixedByTerms;
    AdjustOptions { refine, gauge, max_iterations: 100, ..AdjustOptions::default() }
        .with_noise(relative_noise(model))
}

/// How a model is brought into the frame of the points.
#[derive(Clone, Copy, PartialEq)]
enum Method {
    Similarity,
    FixedLens,
    Lens,
}

impl Method {
    const ALL: [Self; 3] = [Self::Similarity, Self::FixedLens, Self::Lens];

    fn name(self) -> &'static str {
        match self {
            Self::Similarity => "similarity",
            Self::FixedLens => "adjusted, lens fixed",
            Self::Lens => "adjusted, lens refined",
        }
    }

    fn refine(self) -> RefineIntrinsics {
        match self {
            Self::Lens => RefineIntrinsics::FOCAL_AND_DISTORTION,
            Self::Similarity | Self::FixedLens => RefineIntrinsics::NONE,
        }
    }

    fn run(
        self,
        model: &Reconstruction,
        points: &[MarkedPoint],
    ) -> Outcome<(Reconstruction, Vec<PointError>)> {
        let why = |misfit| format!("{misfit:?}");
        let mut model = model.clone();
        if self == Self::Similarity {
            let found = align_to_points(&model, points).map_err(why)?;
            model.transform(&found.term_from_model);
            return Ok((model, found.points));
        }
        model.transform(&first_similarity_to_points(&model, points, false).map_err(why)?);
        let options = options(&model, self.refine());
        let found = adjust_to_points(&mut model, points, &options, &mut [], &mut keep_going)?;
        Ok((model, found.points))
    }
}

/// All points as landmarks, with marks of one deviation, for the bound.
struct BoundTerm<'a> {
    points: &'a [MarkedPoint],
    has_check_marks: bool,
    keys: Vec<Key<Vector3<f64>>>,
    marks: BTreeMap<ImageId, Vec<Mark>>,
}

impl Term for BoundTerm<'_> {
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        for point in self.points {
            let key = variables.problem_mut().add_landmark(point.xyz);
            if !point.is_check {
                let prior = Prior::new(point.xyz, &(point.sigmas_m / context.noise).into())?;
                variables.problem_mut().add(key, prior, Loss::Trivial)?;
            }
            // Exact marks: those of check points do not add to the error of the model.
            let is_exact = point.is_check && !self.has_check_marks;
            let sigma_px = if is_exact { 1e-3 } else { point.mark_sigma_px } / context.noise;
            for &(image, pixel) in &point.marks {
                let mark = Mark { point: key, pixel, sigma_px, loss: Loss::Trivial };
                self.marks.entry(image).or_default().push(mark);
            }
            self.keys.push(key);
        }
        Ok(())
    }

    fn marks_of(&self, image: ImageId) -> &[Mark] {
        self.marks.get(&image).map_or(&[], Vec::as_slice)
    }
}

/// The mean of the squared Cramér-Rao bounds of the check points, in m²; NaN where a variable of
/// the problem is undetermined.
fn bound_m2(
    truth: &Reconstruction,
    points: &[MarkedPoint],
    refine: RefineIntrinsics,
    has_check_marks: bool,
) -> Outcome<f64> {
    let options = AdjustOptions { loss: Loss::Trivial, ..options(truth, refine) };
    let check = |index: usize| points[index].is_check;
    // Exact marks of one check point at a time: together they would determine the model.
    let groups: Vec<Vec<MarkedPoint>> = match has_check_marks {
        true => vec![points.to_vec()],
        false => (0..points.len())
            .filter(|index| check(*index))
            .map(|index| {
                let control = points.iter().filter(|point| !point.is_check);
                control.chain([&points[index]]).cloned().collect()
            })
            .collect(),
    };
    let (mut sum, mut count) = (0.0, 0);
    for points in groups {
        let (keys, marks) = (Vec::new(), BTreeMap::new());
        let mut term = BoundTerm { points: &points, has_check_marks, keys, marks };
        let variables = build_problem(truth, &Scope::Global, &options, &mut [&mut term])?;
        let checks = points.iter().zip(&term.keys).filter(|(point, _)| point.is_check);
        let keys: Vec<AnyKey> = checks.map(|(_, key)| (*key).into()).collect();
        let covariance = match variables.problem().covariance(&keys) {
            Err(ba::Error::Undetermined { .. }) => return Ok(f64::NAN),
            covariance => covariance?,
        };
        sum += covariance.matrix().trace() * options.noise.powi(2);
        count += keys.len();
    }
    Ok(sum / count as f64)
}

fn mean_square(errors: &[PointError]) -> f64 {
    let squares = errors.iter().filter_map(|point| Some(point.error_m?.norm_squared()));
    squares.clone().sum::<f64>() / squares.count() as f64
}

/// What is said of wrong points or marks, and of right ones.
#[derive(Clone, Default)]
struct Named {
    wrong: usize,
    right: usize,
    /// Wrong ones that are named; that are among several of which one is wrong; that are left out,
    /// or are such that another one is left out in their place.
    found: usize,
    among: usize,
    /// Right ones that are named, and that are left out in place of the wrong one.
    others: usize,
    in_its_place: usize,
    /// Errors of the wrong coordinate that are detected, and attributed.
    detectable_m: Vec<f64>,
    separable_m: Vec<f64>,
}

impl Named {
    fn count(&mut self, points: &[MarkedPoint], errors: &[PointError], wrong: Option<usize>) {
        for (index, error) in errors.iter().enumerate().filter(|(k, _)| !points[*k].is_check) {
            let is_among = |k: usize| error.alternatives.contains(&k);
            match wrong == Some(index) {
                true => {
                    self.wrong += 1;
                    self.found += usize::from(error.is_wrong);
                    self.among += usize::from(!error.alternatives.is_empty());
                }
                false => {
                    self.right += 1;
                    self.others += usize::from(error.is_wrong);
                    self.among += usize::from(wrong.is_some_and(is_among));
                    self.in_its_place += usize::from(!error.alternatives.is_empty());
                }
            }
        }
    }

    fn add(&mut self, other: Self) {
        self.wrong += other.wrong;
        self.right += other.right;
        self.found += other.found;
        self.among += other.among;
        self.others += other.others;
        self.in_its_place += other.in_its_place;
        self.detectable_m.extend(other.detectable_m);
        self.separable_m.extend(other.separable_m);
    }

    fn line(&self) -> String {
        let Self { wrong, right, found, among, others, in_its_place, .. } = self;
        let sizes = [&self.detectable_m, &self.separable_m].map(|sizes| {
            let median_m = median(&mut sizes.clone());
            median_m.map_or(String::new(), |size_m| format!("{size_m:.2}"))
        });
        format!(
            "{found} of {wrong} | {among} | {others} of {right} | {in_its_place} | {}",
            sizes.join(" | ")
        )
    }
}

fn named(
    truth_points: &[SurveyedPoint],
    bent: &Reconstruction,
    survey: Survey,
    seed: u64,
) -> Outcome<Vec<(String, Named)>> {
    let points = survey.measured(truth_points, seed);
    let index = seed as usize % survey.num_control;
    let axis = seed as usize % 3;
    let mut all = Vec::new();
    let (_, errors) = Method::Lens.run(bent, &points)?;
    let mut nothing = Named::default();
    nothing.count(&points, &errors, None);
    let size_m = |sizes_m: Option<Vector3<f64>>| sizes_m.map(|sizes_m| sizes_m[axis]);
    let detectable_m: Vec<f64> = size_m(errors[index].detectable_m).into_iter().collect();
    let separable_m: Vec<f64> = size_m(errors[index].separable_m).into_iter().collect();
    all.push(("nothing".to_owned(), nothing));
    for wrong_m in WRONG_M {
        let mut wrong = points.clone();
        wrong[index].xyz[axis] += wrong_m;
        let mut named = Named {
            detectable_m: detectable_m.clone(),
            separable_m: separable_m.clone(),
            ..Named::default()
        };
        match Method::Lens.run(bent, &wrong) {
            Ok((_, errors)) => named.count(&points, &errors, Some(index)),
            // The points are refused, and none is named.
            Err(_) => named.wrong += 1,
        }
        all.push((format!("a point, by {wrong_m} m"), named));
    }
    let mut wrong = points.clone();
    wrong[index].marks[0].1.x += WRONG_PX;
    let (_, errors) = Method::Lens.run(bent, &wrong)?;
    let image = wrong[index].marks[0].0;
    let mut marks = Named::default();
    for (k, error) in errors.iter().enumerate().filter(|(k, _)| !points[*k].is_check) {
        marks.wrong += usize::from(k == index);
        marks.right += error.num_marks - usize::from(k == index);
        let is_wrong = |mark: &&ImageId| k == index && **mark == image;
        marks.found += error.wrong_marks.iter().filter(is_wrong).count();
        marks.others += error.wrong_marks.iter().filter(|mark| !is_wrong(mark)).count();
    }
    all.push((format!("a mark, by {WRONG_PX} px"), marks));
    Ok(all)
}

fn argument(name: &str) -> Option<String> {
    let words: Vec<String> = std::env::args().collect();
    let at = words.iter().position(|word| word == name)?;
    words.get(at + 1).cloned()
}

fn number(name: &str, default: f64) -> Outcome<f64> {
    Ok(argument(name).map_or(Ok(default), |word| word.parse())?)
}

fn write(folder: &Path, name: &str, model: &Reconstruction) -> Outcome<()> {
    let folder = folder.join(name);
    std::fs::create_dir_all(&folder)?;
    Ok(write_model(&folder, model, Format::Binary)?)
}

fn write_points(folder: &Path, model: &Reconstruction, points: &[MarkedPoint]) -> Outcome<()> {
    let mut text = String::from("point,x,y,z,image,px,py,sigma,sigma_px\n");
    for (index, point) in points.iter().enumerate() {
        let [x, y, z] = point.xyz.into();
        let (sigma_m, sigma_px) = (point.sigmas_m.x, point.mark_sigma_px);
        let name = format!("{}{index}", if point.is_check { "CHK-" } else { "" });
        for (image, pixel) in &point.marks {
            let image = &model.image(*image).name;
            let (px, py) = (pixel.x, pixel.y);
            text += &format!("{name},{x},{y},{z},{image},{px},{py},{sigma_m},{sigma_px}\n");
        }
    }
    Ok(std::fs::write(folder.join("points.csv"), text)?)
}

/// Root mean squares of the check points, with their bounds, for each lens and method.
fn print_errors(scene: &Scene, survey: Survey, seeds: u64, folder: Option<&Path>) -> Outcome<()> {
    let num_control = survey.num_control;
    let mut sums = [[[0.0; 4]; 3]; 2];
    for seed in 1..=seeds {
        let truth = scene.truth(seed)?;
        let surveyed = surveyed_points(&truth, num_control + NUM_CHECK, MIN_MARKS);
        let points = survey.measured(&surveyed, seed);
        let true_pixels = exact(&surveyed, num_control);
        let of_lens = of_images(&truth, 0.0)?;
        let mut bounds = [[0.0; 2]; 3];
        for (bounds, method) in bounds.iter_mut().zip(Method::ALL) {
            for (bound, has_check_marks) in bounds.iter_mut().zip([true, false]) {
                *bound = bound_m2(&of_lens, &points, method.refine(), has_check_marks)?;
            }
        }
        for (bend, radial) in [0.0, RADIAL].into_iter().enumerate() {
            let model = of_images(&truth, radial)?;
            for (k, method) in Method::ALL.into_iter().enumerate() {
                let (placed, errors) = method.run(&model, &points)?;
                let sums = &mut sums[bend][k];
                sums[0] += mean_square(&errors[num_control..]);
                sums[2] += mean_square(&point_errors(&placed, &true_pixels));
                sums[1] += bounds[k][0];
                sums[3] += bounds[k][1];
                if let (1, Method::Lens, Some(folder)) = (bend, method, folder) {
                    let name = scene.name.split(' ').next().unwrap_or("scene");
                    let folder = folder.join(format!("{name}-{seed}"));
                    write(&folder, "before", &model)?;
                    write(&folder, "after", &placed)?;
                    write_points(&folder, &model, &points)?;
                }
            }
        }
    }
    for (lens, sums) in ["right", "off"].iter().zip(&sums) {
        for (method, sums) in Method::ALL.iter().zip(sums) {
            let cells = sums.map(|sum| format!("{:.2}", 100.0 * (sum / seeds as f64).sqrt()));
            println!("| {} | {lens} | {} | {} |", scene.name, method.name(), cells.join(" | "));
        }
    }
    Ok(())
}

/// What is said of wrong points and marks.
fn print_wrong(scene: &Scene, survey: Survey, seeds: u64) -> Outcome<()> {
    let mut all: Vec<(String, Named)> = Vec::new();
    for seed in 1..=seeds {
        let truth = scene.truth(seed)?;
        let surveyed = surveyed_points(&truth, survey.num_control + NUM_CHECK, MIN_MARKS);
        let found = named(&surveyed, &of_images(&truth, RADIAL)?, survey, seed)?;
        if all.is_empty() {
            all = found;
            continue;
        }
        for (sum, (_, one)) in all.iter_mut().zip(found) {
            sum.1.add(one);
        }
    }
    for (what, named) in all {
        println!("| {} | {} | {what} | {} |", scene.name, survey.num_control, named.line());
    }
    Ok(())
}

fn main() -> Outcome<()> {
    let seeds = number("--seeds", 8.0)? as u64;
    let num_control = number("--control", 4.0)? as usize;
    let (survey_m, mark_px) = (number("--survey", 0.01)?, number("--marks", 3.0)?);
    let survey = Survey { num_control, survey_m, mark_px };
    let folder = argument("--write").map(PathBuf::from);
    let only = argument("--only");
    if only.as_deref() != Some("wrong") {
        println!(
            "| scene | lens of the model | brought to the points by | check points, cm | bound, cm \
             | of true pixels, cm | bound, cm |\n|---|---|---|--:|--:|--:|--:|"
        );
        for scene in &SCENES {
            print_errors(scene, survey, seeds, folder.as_deref())?;
        }
    }
    if only.as_deref() != Some("errors") {
        println!(
            "\n| scene | control points | wrong | named | one of several | right ones named | left \
             out for it | detected from, m | attributed from, m |\n\
             |---|--:|---|--:|--:|--:|--:|--:|--:|"
        );
        for scene in &SCENES {
            print_wrong(scene, survey, seeds)?;
        }
    }
    Ok(())
}
