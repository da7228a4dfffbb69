//! Control points: their file, and models that are adjusted together with them.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use tiepoint_input::fingerprint::hash_bytes;
use tiepoint_io::control_points::{self, ControlPoint};
use tiepoint_io::names::ByName;
use tiepoint_sfm::adjust::{self, AdjustOptions, Gauge, Term, relative_noise};
use tiepoint_sfm::ba::{IterationRecord, Summary};
use tiepoint_sfm::geometry::Sim3;
use tiepoint_sfm::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_sfm::positions::{
    ControlMisfit, MarkedPoint, PointError, adjust_to_points, first_similarity_to_points,
    point_errors, with_global_shutter,
};
use tiepoint_sfm::rigs::SoftRig;
use tiepoint_sfm::rolling_shutter::{RollingShutter, row_poses};
use tiepoint_sfm::scene::{Georeference, ImageId, KnownRigs, Place, Reconstruction};
use tiepoint_sfm::{MappedModel, MapperOptions};

use crate::stages::positions::transform;
use crate::workspace::control_report::{ControlPointReport, ControlReport, PointStatistics};
use crate::workspace::file_names::model_path;
use crate::{Error, Event, Watch, emit};

/// Standard deviations of a control point along a horizontal axis and of its height, in metres, if
/// its file states none: an assumption, of a survey by a total station or with RTK near its base.
const CONTROL_SIGMAS_M: [f64; 2] = [0.01; 2];
/// Standard deviation of the coordinates of a mark in pixels, if its file states none: an
/// assumption, of marks by hand in photos of 10 to 20 megapixels.
const MARK_SIGMA_PX: f64 = 3.0;
/// Steps of an adjustment with control points.
const MAX_ITERATIONS: usize = 100;

/// Least noise of keypoints beside control points, as a multiple of their standard deviation: that
/// of exact ones is rounding, and nothing would move them.
const MIN_NOISE: f64 = 0.05;

/// Why a frame with z up is refused.
pub(crate) const UPSIDE_DOWN: &str = "it would be upside down: are two coordinates swapped?";

/// The control points of a file, and their frame.
pub(crate) struct ControlPoints {
    file: PathBuf,
    points: Vec<ControlPoint>,
    georeference: Georeference,
}

/// A model in the frame of control points.
pub(crate) struct Adjusted {
    pub(crate) summary: Summary,
    pub(crate) points: Vec<ControlPointReport>,
}

impl ControlPoints {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// Those of [`control_points::read`].
    pub(crate) fn read(file: &Path) -> Result<Self, Error> {
        let points = control_points::read(file)?;
        let places: Vec<Place> = points.iter().map(|point| point.place).collect();
        let georeference = Georeference::near(&places);
        // There is a point, and so a frame near it.
        let georeference =
            georeference.unwrap_or(Georeference::Cartesian { offset: Vector3::zeros() });
        Ok(Self { file: file.to_owned(), points, georeference })
    }

    /// The file.
    pub(crate) fn file(&self) -> &Path {
        &self.file
    }

    /// Where on the earth the frame is.
    pub(crate) fn georeference(&self) -> Georeference {
        self.georeference
    }

    /// Their hash, for the record of the stage.
    pub(crate) fn hash(&self) -> String {
        hash_bytes(format!("{:?}", self.points).as_bytes())
    }

    /// The points with their marks in the images of a model, as a global shutter would show them.
    ///
    /// # Errors
    ///
    /// No mark is in an image of the model, or the points have no place in a frame; in words.
    pub(crate) fn marked(
        &self,
        model: &Reconstruction,
        shutters: &[RollingShutter],
        frame: &Georeference,
    ) -> Result<Vec<MarkedPoint>, String> {
        let by_name: BTreeMap<String, ImageId> =
            model.images().map(|(id, image)| (image.name.clone(), id)).collect();
        let by_name = ByName::new(by_name);
        let of_mark = |(name, pixel): &(String, Vector2<f64>)| Some((*by_name.get(name)?, *pixel));
        let marked = self.points.iter().map(|point| {
            let [horizontal, vertical] = point.sigmas_m.unwrap_or(CONTROL_SIGMAS_M);
            Some(MarkedPoint {
                xyz: frame.to_local(&point.place)?,
                sigmas_m: Vector3::new(horizontal, horizontal, vertical),
                is_check: point.is_check,
                mark_sigma_px: point.mark_sigma_px.unwrap_or(MARK_SIGMA_PX),
                marks: point.marks.iter().filter_map(of_mark).collect(),
            })
        });
        let Some(marked) = marked.collect::<Option<Vec<MarkedPoint>>>() else {
            return Err(match frame {
                Georeference::Enu { .. } => {
                    "it is in a frame on the earth, and the points have local coordinates"
                }
                Georeference::Cartesian { .. } => {
                    "it is in a local frame, and the points are on the earth"
                }
            }
            .to_owned());
        };
        if marked.iter().all(|point| point.marks.is_empty()) {
            let mut marks = self.points.iter().flat_map(|point| &point.marks);
            let first = marks.next().map_or("", |(name, _)| name);
            return Err(format!(
                "no image of the marks, as {first}, is one of its {} images; images are compared \
                 by name",
                model.images().count()
            ));
        }
        Ok(with_global_shutter(model, shutters, &marked))
    }

    /// What is reported of the points.
    pub(crate) fn reports(
        &self,
        model: &Reconstruction,
        errors: &[PointError],
    ) -> Vec<ControlPointReport> {
        let sizes = |sizes_m: Option<Vector3<f64>>| -> [Option<f64>; 3] {
            let sizes_m = sizes_m.unwrap_or(Vector3::repeat(f64::INFINITY));
            <[f64; 3]>::from(sizes_m).map(|size_m| Some(size_m).filter(|size_m| size_m.is_finite()))
        };
        let report = |(point, error): (&ControlPoint, &PointError)| ControlPointReport {
            name: point.name.clone(),
            is_check: point.is_check,
            is_wrong: error.is_wrong,
            alternatives: error.alternatives.iter().map(|&k| self.points[k].name.clone()).collect(),
            marks: error.num_marks,
            inlier_marks: error.error_m.map_or(0, |_| error.num_marks - error.wrong_marks.len()),
            wrong_marks: error.wrong_marks.iter().map(|id| model.image(*id).name.clone()).collect(),
            rms_px: error.rms_px,
            error_m: error.error_m.map(Into::into),
            sigmas_m: error.error_m.map(|_| error.sigmas_m.into()),
            detectable_m: sizes(error.detectable_m),
            separable_m: sizes(error.separable_m),
        };
        self.points.iter().zip(errors).map(report).collect()
    }

    /// Why they do not determine the frame, and what to do.
    pub(crate) fn why_undetermined(&self, misfit: ControlMisfit) -> String {
        let all = self.points.iter().filter(|point| !point.is_check).count();
        match misfit {
            ControlMisfit::TooFew { usable } => format!(
                "{usable} of {all} control points are usable, and three that are not on a line are \
                 needed, each marked in two images with a pose and in different directions"
            ),
            ControlMisfit::Uncertain { usable, rotation_sd_rad, scale_sd } => format!(
                "its {usable} usable control points are near a line or near each other, which \
                 leaves a rotation uncertain by {:.0}° and the scale by {:.0} %: mark a point \
                 beside the line, far from the others",
                rotation_sd_rad.to_degrees().min(180.0),
                100.0 * scale_sd.min(9.99)
            ),
            ControlMisfit::UpsideDown => UPSIDE_DOWN.to_owned(),
            ControlMisfit::Contradiction { sigma_m, extent_m } => format!(
                "the control points are {sigma_m:.2} m from their places in the model, for an \
                 extent of {extent_m:.2} m: are coordinates swapped, or names of points or images?"
            ),
        }
    }

    /// The errors of the points in a model in their frame.
    ///
    /// # Errors
    ///
    /// As of [`ControlPoints::marked`]; or the model has no frame.
    pub(crate) fn evaluate(
        &self,
        model: &Reconstruction,
        shutters: &[RollingShutter],
    ) -> Result<ControlReport, String> {
        let is_local = matches!(self.georeference, Georeference::Cartesian { .. });
        let frame = match model.georeference {
            Some(frame) => frame,
            // A model of another program may be in the frame of local coordinates.
            None if is_local => Georeference::Cartesian { offset: Vector3::zeros() },
            None => {
                return Err("it is not in a frame on the earth: see `model.align`".to_owned());
            }
        };
        let marked = self.marked(model, shutters, &frame)?;
        Ok(self.reports(model, &point_errors(model, &marked)).into())
    }

    /// Adjusts a model that is near the frame of the points together with them and `terms`.
    ///
    /// # Errors
    ///
    /// The adjustment fails.
    fn adjust(
        &self,
        model: &mut Reconstruction,
        marked: &[MarkedPoint],
        options: &AdjustOptions,
        terms: &mut [&mut dyn Term],
        watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
    ) -> Result<Adjusted, adjust::Error> {
        let options = AdjustOptions {
            gauge: Gauge::FixedByTerms,
            max_iterations: MAX_ITERATIONS,
            ..*options
        };
        let options = options.with_noise(relative_noise(model).max(MIN_NOISE));
        let found = adjust_to_points(model, marked, &options, terms, watch)?;
        model.georeference = Some(self.georeference);
        Ok(Adjusted { points: self.reports(model, &found.points), summary: found.summary })
    }

    /// Moves a model into the frame of the points, and adjusts it together with them.
    ///
    /// # Errors
    ///
    /// The points do not determine the frame, or the adjustment fails.
    pub(crate) fn adjust_finished(
        &self,
        (path, model): (&Path, &mut Reconstruction),
        shutters: &[RollingShutter],
        options: &AdjustOptions,
        watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
    ) -> Result<Adjusted, Error> {
        let failed = |reason: String| Error::NoAlignment {
            model: path.to_owned(),
            reference: self.file.clone(),
            reason,
        };
        let marked = self.marked(model, shutters, &self.georeference).map_err(failed)?;
        let similarity = first_similarity_to_points(model, &marked, false)
            .map_err(|misfit| failed(self.why_undetermined(misfit)))?;
        model.transform(&similarity);
        self.adjust(model, &marked, options, &mut [], watch).map_err(Error::adjusting(path))
    }

    /// Moves models into the frame of the points, and adjusts them together with them. Known rigs
    /// that are not refined keep their scale.
    ///
    /// # Errors
    ///
    /// `watch` returns `Break`.
    pub(crate) fn place(
        &self,
        models: &mut [MappedModel],
        mapper: &MapperOptions,
        rigs: Option<&KnownRigs>,
        watch: Watch,
    ) -> Result<PlacedByPoints, Error> {
        let mut placed = PlacedByPoints::default();
        for (index, mapped) in models.iter_mut().enumerate() {
            emit(watch, &Event::Noted { what: "adjusting the model with the control points" })?;
            let name = model_path(index);
            match self.place_one(mapped, mapper, rigs, watch)? {
                Ok((factor, points)) => {
                    let report = ControlReport::from(points);
                    placed.notes.extend(sentences(&name, &report));
                    placed.reports.push(Some(report));
                    placed.factors.push(factor);
                }
                Err(why) => {
                    placed.notes.push(format!("control points are not used for {name}: {why}"));
                    placed.reports.push(None);
                    placed.factors.push(1.0);
                }
            }
        }
        Ok(placed)
    }

    /// [`ControlPoints::place`] of a model, which stays as it is if that fails. The inner error
    /// says why. Also returns the length of the unit that the model had.
    fn place_one(
        &self,
        mapped: &mut MappedModel,
        mapper: &MapperOptions,
        rigs: Option<&KnownRigs>,
        watch: Watch,
    ) -> Result<Result<(f64, Vec<ControlPointReport>), String>, Error> {
        let model = &mapped.reconstruction;
        let marked = match self.marked(model, &mapped.shutters, &self.georeference) {
            Ok(marked) => marked,
            Err(why) => return Ok(Err(why)),
        };
        let constant_rigs =
            !model.frames.is_empty() && rigs.is_some_and(|rigs| !rigs.refine_extrinsics);
        let similarity = match first_similarity_to_points(model, &marked, constant_rigs) {
            Ok(similarity) => similarity,
            Err(misfit) => return Ok(Err(self.why_undetermined(misfit))),
        };
        let mut moved = mapped.clone();
        transform(&mut moved, similarity);
        let model = &mut moved.reconstruction;
        let options =
            AdjustOptions { refine: mapper.refine, constant_rigs, ..AdjustOptions::default() };
        let mut is_stopped = false;
        let mut step = |step: &IterationRecord| {
            let flow = watch(&Event::AdjustmentStep { step: step.number, cost: step.cost });
            is_stopped |= flow.is_break();
            flow
        };
        let mut soft = moved.rig.as_ref().map(|rig| SoftRig::new(model, rig));
        let found = match &mut soft {
            Some(soft) => {
                let term: &mut dyn Term = &mut soft.term();
                self.adjust(model, &marked, &options, &mut [term], &mut step)
            }
            None => self.adjust(model, &marked, &options, &mut [], &mut step),
        };
        if is_stopped {
            return Err(Error::Cancelled);
        }
        let found = match found {
            Ok(found) => found,
            Err(error) => return Ok(Err(error.to_string())),
        };
        if let (Some(soft), Some(rig)) = (&soft, &mut moved.rig) {
            soft.update(&moved.reconstruction, rig);
        }
        moved.row_poses = row_poses(&moved.reconstruction, &moved.shutters);
        *mapped = moved;
        Ok(Ok((similarity.scale, found.points)))
    }

    /// The similarity alone, and the points after it.
    ///
    /// # Errors
    ///
    /// The points do not determine it.
    pub(crate) fn align(
        &self,
        (path, model): (&Path, &Reconstruction),
        shutters: &[RollingShutter],
    ) -> Result<(Sim3, Vec<ControlPointReport>), Error> {
        let failed = |reason: String| Error::NoAlignment {
            model: path.to_owned(),
            reference: self.file.clone(),
            reason,
        };
        let marked = self.marked(model, shutters, &self.georeference).map_err(failed)?;
        let found = tiepoint_sfm::positions::align_to_points(model, &marked)
            .map_err(|misfit| failed(self.why_undetermined(misfit)))?;
        Ok((found.term_from_model, self.reports(model, &found.points)))
    }
}

/// What became of control points.
#[derive(Default)]
pub(crate) struct PlacedByPoints {
    /// For each model, if it is in their frame.
    pub(crate) reports: Vec<Option<ControlReport>>,
    /// For each model, the length of the unit that it had before.
    pub(crate) factors: Vec<f64>,
    /// A sentence each.
    pub(crate) notes: Vec<String>,
}

/// What is to be said of the control points of a model.
fn sentences(model: &str, report: &ControlReport) -> Vec<String> {
    let all = report.points.iter().filter(|point| !point.is_check).count();
    let mut sentences = Vec::new();
    if let Some(control) = &report.control {
        let errors = errors_in_words(control);
        let used = control.points;
        sentences.push(format!(
            "{model} is in metres, in the frame of the control points, and was adjusted together \
             with {used} of {all}: errors {errors}"
        ));
    }
    if let Some(check) = &report.check {
        let (count, errors) = (check.points, errors_in_words(check));
        sentences.push(format!("{count} check points of {model}: errors {errors}"));
    }
    sentences.extend(undetermined_in_words(model, report));
    sentences.extend(detectable_in_words(report));
    for point in &report.points {
        let name = &point.name;
        if let (true, Some([x, y, z])) = (point.is_wrong, point.error_m) {
            sentences.push(format!(
                "the control point {name} is wrong by {x:.2} {y:.2} {z:.2} m, and is not used"
            ));
        }
        if !point.alternatives.is_empty() {
            sentences.push(format!(
                "one of the control points {name}, {} is wrong, and the measurements do not tell \
                 which: {name}, without which the errors are smallest, is not used",
                point.alternatives.join(", ")
            ));
        }
        if !point.wrong_marks.is_empty() {
            let images = point.wrong_marks.join(", ");
            sentences.push(format!("the marks of {name} in {images} are wrong, and are not used"));
        }
    }
    sentences
}

/// Which points their marks do not determine; `None` if there are none.
fn undetermined_in_words(model: &str, report: &ControlReport) -> Option<String> {
    let named = |point: &ControlPointReport| {
        let marks = if point.marks == 1 { "mark" } else { "marks" };
        format!("{} ({} {marks})", point.name, point.marks)
    };
    let points = report.points.iter().filter(|point| point.error_m.is_none());
    let points: Vec<String> = points.map(named).collect();
    (!points.is_empty()).then(|| {
        format!(
            "not used, since it takes two marks that agree, in images of {model} and in different \
             directions: {}",
            points.join(", ")
        )
    })
}

/// Which errors of control points go unnoticed; `None` where none is tested.
fn detectable_in_words(report: &ControlReport) -> Option<String> {
    let control = || report.points.iter().filter(|point| !point.is_check);
    let is_tested = |point: &ControlPointReport| point.detectable_m.iter().any(Option::is_some);
    control().any(is_tested).then_some(())?;
    let largest = |sizes_m: &dyn Fn(&ControlPointReport) -> [Option<f64>; 3]| {
        let sizes = control().flat_map(sizes_m).map(|size_m| size_m.unwrap_or(f64::INFINITY));
        let largest_m = sizes.fold(0.0, f64::max);
        match largest_m.is_finite() {
            true => format!("{largest_m:.2} m"),
            false => "any size".to_owned(),
        }
    };
    Some(format!(
        "errors of up to {} in a coordinate of one control point may go unnoticed, and of up to {} \
         may be those of another one (one case in five)",
        largest(&|point| point.detectable_m),
        largest(&|point| point.separable_m)
    ))
}

fn errors_in_words(statistics: &PointStatistics) -> String {
    let [x, y, z] = statistics.rms_m;
    format!("{x:.3} m east, {y:.3} m north and {z:.3} m up (root mean square)")
}
