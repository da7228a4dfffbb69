//! What measured positions do to the drift of a drive: `cargo run --release -p tiepoint-sfm
//! --example positions -- [--length 600] [--seeds 5] [--clock 1]`.
//!
//! A drive of one camera is mapped from keypoints and verified matches, without positions and with
//! them in the adjustments. Each line is of one kind of positions: the root mean square distance of
//! the cameras from the truth after the similarity to the positions without them, with them, and
//! what is kept; how many were kept of the seeds; and the deviation that was estimated. With
//! `--clock 1`, positions once a second have a clock that is 0.7 s ahead, and are of an antenna
//! beside the camera: each line has the root mean square errors of offset and arm over the seeds,
//! and beside them the deviations that are stated.

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use tiepoint_rig::Trajectory;
use tiepoint_sfm::adjust::RefineIntrinsics;
use tiepoint_sfm::geometry::nalgebra::Vector3;
use tiepoint_sfm::geometry::{Rng, Sim3};
use tiepoint_sfm::positions::{
    MeasuredPosition, PositionTerm, TimedPosition, align, align_track, compare, held_out,
};
use tiepoint_sfm::scene::{CorrespondenceGraph, Reconstruction};
use tiepoint_sfm::{MappedModel, Mapper, MapperOptions, RigMode};
use tiepoint_synth::{
    Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions, Mount, RouteKind,
};

const OBSERVATIONS_AN_IMAGE: usize = 400;

/// Errors of positions.
#[derive(Clone, Copy)]
struct Kind {
    name: &'static str,
    /// Standard deviation of the white noise along each axis; of the height twice.
    noise_m: f64,
    /// Standard deviation and correlation length, in images, of slow errors.
    slow_m: f64,
    correlation: f64,
    /// Share of gross errors of 50 m.
    gross: f64,
    is_stated: bool,
}

const fn kind(name: &'static str, noise_m: f64, slow_m: f64, gross: f64, is_stated: bool) -> Kind {
    Kind { name, noise_m, slow_m, correlation: 20.0, gross, is_stated }
}

const KINDS: [Kind; 7] = [
    kind("0.02 m stated", 0.02, 0.0, 0.0, true),
    kind("2 m stated", 2.0, 0.0, 0.0, true),
    kind("2 m unknown", 2.0, 0.0, 0.0, false),
    kind("2 m, 5 % gross", 2.0, 0.0, 0.05, true),
    kind("1 m, 2 m slow, 5 % gross, unknown", 1.0, 2.0, 0.05, false),
    kind("10 m slow stated as 1 m", 1.0, 10.0, 0.0, true),
    kind("1 m, 40 % gross, unknown", 1.0, 0.0, 0.4, false),
];

struct Street {
    truth: Reconstruction,
    blank: Reconstruction,
    graph: CorrespondenceGraph,
}

fn street(length_m: f64, seed: u64) -> Result<Street, Box<dyn std::error::Error>> {
    let drive = Drive::new(&DriveOptions {
        seed,
        length_m,
        route: RouteKind::Open,
        rate_hz: 3.0,
        mounts: vec![Mount::stereo(tiepoint_synth::ViewDirection::Front, 0.5)[0].clone()],
        ..DriveOptions::default()
    })?;
    let images = drive.cameras().iter().map(|camera| camera.exposures.len()).sum::<usize>();
    let observations = OBSERVATIONS_AN_IMAGE * images;
    let scene = FeatureScene::new(
        &drive,
        &FeatureOptions { seed, observations, ..FeatureOptions::default() },
    )?;
    let graph = scene.graph(&MatchOptions { window: Some(6), ..MatchOptions::default() });
    Ok(Street { truth: scene.truth().clone(), blank: scene.without_poses(), graph })
}

impl Street {
    fn positions(&self, kind: &Kind, seed: u64) -> Vec<MeasuredPosition> {
        let mut rng = Rng::stream(seed, &[]);
        let mut normal = |sigma_m: f64| {
            let up = 2.0 * sigma_m;
            Vector3::new(sigma_m * rng.normal(), sigma_m * rng.normal(), up * rng.normal())
        };
        // A Gauss-Markov process.
        let keep = (-1.0 / kind.correlation).exp();
        let mut slow = normal(kind.slow_m);
        let mut gross = Rng::stream(seed, &[1]);
        let stated = kind.is_stated.then_some([kind.noise_m, 2.0 * kind.noise_m]);
        let truth: Vec<_> = self.truth.registered().collect();
        let measure = |(image, _, pose): &(_, _, &tiepoint_sfm::geometry::Rigid3)| {
            slow = keep * slow + (1.0 - keep * keep).sqrt() * normal(kind.slow_m);
            let is_gross = gross.uniform() < kind.gross;
            let far = if is_gross { normal(50.0) } else { Vector3::zeros() };
            let xyz = pose.origin_in_a() + normal(kind.noise_m) + slow + far;
            MeasuredPosition { image: *image, xyz, has_height: true, sigmas_m: stated }
        };
        truth.iter().map(measure).collect()
    }

    /// Once a second, by a clock that is [`OFFSET_S`] ahead, of an antenna at [`ARM_M`].
    fn track(&self, kind: &Kind, seed: u64) -> Vec<TimedPosition> {
        let timed =
            self.truth.registered().filter_map(|(_, image, pose)| Some((image.time_s?, *pose)));
        let trajectory = Trajectory::new(timed);
        let (Some(first_s), Some(last_s)) =
            (trajectory.times_s().first(), trajectory.times_s().last())
        else {
            return Vec::new();
        };
        let mut rng = Rng::stream(seed, &[2]);
        let mut normal = |sigma_m: f64| {
            let up = 2.0 * sigma_m;
            Vector3::new(sigma_m * rng.normal(), sigma_m * rng.normal(), up * rng.normal())
        };
        let keep = (-1.0 / kind.correlation).exp();
        let mut slow = normal(kind.slow_m);
        let mut gross = Rng::stream(seed, &[3]);
        let mut fixes = Vec::new();
        for second in 0..(last_s - first_s) as usize {
            let time_s = first_s + 0.4 + second as f64;
            slow = keep * slow + (1.0 - keep * keep).sqrt() * normal(kind.slow_m);
            let is_gross = gross.uniform() < kind.gross;
            let far = if is_gross { normal(50.0) } else { Vector3::zeros() };
            let Some(pose) = trajectory.at(time_s) else { continue };
            let xyz = pose.inverse() * ARM_M + normal(kind.noise_m) + slow + far;
            let time_s = time_s + OFFSET_S;
            fixes.push(TimedPosition { time_s, xyz, has_height: true, sigmas_m: None });
        }
        fixes
    }

    fn map(&self, term: Option<&mut PositionTerm>) -> Option<MappedModel> {
        let options = MapperOptions {
            refine: RefineIntrinsics::NONE,
            rig: RigMode::Off,
            ..MapperOptions::default()
        };
        let mut mapper = Mapper::new(&self.graph, &self.blank);
        if let Some(term) = term {
            mapper = mapper.term(term);
        }
        mapper.run(&options).ok()?.into_iter().next()
    }

    fn rms_m(&self, model: &Reconstruction, similarity: &Sim3) -> f64 {
        let squared = model.registered().filter_map(|(id, _, pose)| {
            let there = self.truth.image(id).cam_from_world()?.origin_in_a();
            Some((*similarity * pose.origin_in_a() - there).norm_squared())
        });
        (squared.sum::<f64>() / model.num_registered() as f64).sqrt()
    }
}

fn argument(name: &str, default: f64) -> f64 {
    let words: Vec<String> = std::env::args().collect();
    let at = words.iter().position(|word| word == name);
    at.map_or(default, |at| words[at + 1].parse().expect("a number"))
}

/// The clock of positions, and the antenna in the axes of the camera: to the right, above, behind.
const OFFSET_S: f64 = 0.7;
const ARM_M: Vector3<f64> = Vector3::new(0.5, -1.0, -1.5);

const TRACKS: [Kind; 4] = [
    kind("2 m white", 2.0, 0.0, 0.0, false),
    kind("2 m white, 5 % gross", 2.0, 0.0, 0.05, false),
    kind("0.5 m white, 2 m over 20 s", 0.5, 2.0, 0.0, false),
    kind("0.5 m white, 2 m over 20 s, 5 % gross", 0.5, 2.0, 0.05, false),
];

/// Prints errors of offset and arm beside their deviations.
fn clocks(length_m: f64, seeds: u64) -> Result<(), Box<dyn std::error::Error>> {
    println!(
        "| positions | offset, s | stated | arm x, m | stated | arm z, m | stated | y, m | \
         centres, m |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|"
    );
    let mut rows: Vec<Vec<[f64; 8]>> = vec![Vec::new(); TRACKS.len()];
    for seed in 1..=seeds {
        let street = street(length_m, seed)?;
        let without = street.map(None).ok_or("no model")?;
        let model = &without.reconstruction;
        for (kind, rows) in TRACKS.iter().zip(&mut rows) {
            let any = f64::NEG_INFINITY..f64::INFINITY;
            let found = match align_track(model, &street.track(kind, seed), any, 0) {
                Ok(found) => found,
                Err(misfit) => {
                    println!("{} seed {seed}: {misfit}", kind.name);
                    continue;
                }
            };
            let sd_m = |axis: usize| found.arm_sds_m[axis];
            let off = found.arm_m - ARM_M;
            let placed = align(model, &found.positions, false, 0);
            let rms_m = placed.map_or(f64::NAN, |it| street.rms_m(model, &it.term_from_model));
            let offset_s = found.offset_s - OFFSET_S;
            let sd_s = found.offset_sd_s;
            rows.push([offset_s, sd_s, off.x, sd_m(0), off.z, sd_m(2), sd_m(1), rms_m]);
        }
    }
    for (kind, rows) in TRACKS.iter().zip(&rows) {
        // Of those seeds whose motion determines the value.
        let rms = |column: usize, of: usize| {
            let squares =
                || rows.iter().filter(|row| row[of].is_finite()).map(|row| row[column].powi(2));
            (squares().sum::<f64>() / squares().count() as f64).sqrt()
        };
        let values = [
            rms(0, 1),
            rms(1, 1),
            rms(2, 3),
            rms(3, 3),
            rms(4, 5),
            rms(5, 5),
            rms(6, 6),
            rms(7, 7),
        ];
        let text: Vec<String> = values.iter().map(|value| format!("{value:.3}")).collect();
        println!("| {} ({} of {seeds}) | {} |", kind.name, rows.len(), text.join(" | "));
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (length_m, seeds) = (argument("--length", 600.0), argument("--seeds", 5.0) as u64);
    if argument("--clock", 0.0) > 0.0 {
        return clocks(length_m, seeds);
    }
    println!(
        "| positions | without, m | with, m | kept, m | kept with | sigma, m |\n\
         |---|--:|--:|--:|--:|--:|"
    );
    let mut sums = [[0.0; 5]; KINDS.len()];
    for seed in 1..=seeds {
        let street = street(length_m, seed)?;
        let without = street.map(None).ok_or("no model")?;
        let model = &without.reconstruction;
        for (kind, sums) in KINDS.iter().zip(&mut sums) {
            let positions = street.positions(kind, seed);
            let Ok(found) = align(model, &positions, false, 0) else {
                println!("{} seed {seed}: no alignment", kind.name);
                continue;
            };
            let mut term = PositionTerm::new(&held_out(&positions).0, found.sigmas_m, 0);
            let with = street.map(Some(&mut term)).ok_or("no model with positions")?;
            let similarity = match with.is_in_frame_of_terms {
                true => Sim3::identity(),
                false => align(&with.reconstruction, &positions, false, 0)
                    .map_or(Sim3::identity(), |a| a.term_from_model),
            };
            let compared = compare(
                &[(model, found.term_from_model)],
                &[(&with.reconstruction, similarity)],
                &positions,
                found.sigmas_m,
            );
            let is_better = compared.is_some_and(|compared| compared.is_better());
            let rms = [
                street.rms_m(model, &found.term_from_model),
                street.rms_m(&with.reconstruction, &similarity),
            ];
            let kept = rms[usize::from(is_better)];
            let row = [rms[0], rms[1], kept, f64::from(u8::from(is_better)), found.sigmas_m[0]];
            sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
    }
    for (kind, sums) in KINDS.iter().zip(&sums) {
        let [without, with, kept, share, sigma] = sums.map(|sum| sum / seeds as f64);
        println!(
            "| {} | {without:.3} | {with:.3} | {kept:.3} | {:.0} of {seeds} | {sigma:.2} |",
            kind.name,
            share * seeds as f64
        );
    }
    Ok(())
}
