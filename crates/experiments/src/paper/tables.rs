//! The tables: first with rows, columns and units of the paper, then with errors that need ground
//! truth.

use tiepoint_pipeline::sfm::RigMode;
use tiepoint_report::{Table, TableRow};

use super::run::{Measurements, Run};
use crate::drive_folder::BASELINE_M;

/// Experiment I.
pub(crate) fn view_directions(runs: &[Run]) -> Vec<Table> {
    let caption = "Table 3 in the rendered world: accuracy for different mounting configurations \
    of monocular cameras (Experiment I)";
    let first = paper_table(caption, "Camera configuration", runs);
    let second = ground_truth_table("Camera configuration", runs, &[]);
    vec![first, second]
}

/// Experiment II.
pub(crate) fn of_constraints(runs: &[Run]) -> Vec<Table> {
    let caption = "Table 4 in the rendered world: accuracy for two uncalibrated cameras that \
    overlap (Experiment II)";
    let traditional =
        runs.iter().find(|run| run.rig == RigMode::Off.name()).and_then(|run| run.result.as_ref());
    let change = |of: fn(&Measurements) -> Option<f64>| {
        move |run: &Run| {
            let (before, after) = (of(traditional?)?, of(run.result.as_ref()?)?);
            Some(format!("{:+.2} %", 100.0 * (after / before - 1.0)))
        }
    };
    let in_distance = change(|measured| Some(measured.dense.as_ref()?.distance.mean_m));
    let in_ate = change(|measured| Some(measured.ate_m));
    let extrinsics_heading = format!("Baseline of extrinsics (true {BASELINE_M:.3}) [m]");
    let (extrinsics, mean) =
        (ours(|measured| measured.extrinsics_m), ours(|measured| measured.baseline_m));
    let (largest, rms) =
        (ours(|measured| measured.largest_baseline_m), ours(|measured| measured.baseline_spread_m));
    let more: [Column; 6] = [
        (&extrinsics_heading, &extrinsics),
        ("Baseline in time, mean [m]", &mean),
        ("max", &largest),
        ("RMS deviation", &rms),
        ("Distance, change", &in_distance),
        ("ATE, change", &in_ate),
    ];
    vec![paper_table(caption, "BA", runs), ground_truth_table("BA", runs, &more)]
}

/// Heading of a row: the paper's name of the method, and the value of --rig.
pub(crate) fn row_of(rig: RigMode) -> String {
    match rig {
        RigMode::Off => format!("Traditional ({})", rig.name()),
        _ => format!("Constrained ({})", rig.name()),
    }
}

/// Heading of the sparse cloud of COLMAP's model.
const COLMAP: &str = "COLMAP";

/// A heading, and the values below it.
type Column<'a> = (&'a str, &'a dyn Fn(&Run) -> Option<String>);

/// A column of our model, in metres.
fn ours(of: fn(&Measurements) -> Option<f64>) -> impl Fn(&Run) -> Option<String> {
    move |run| Some(format!("{:.3}", of(run.result.as_ref()?)?))
}

/// A column of COLMAP's model, in metres.
fn colmap(of: fn(&Measurements) -> Option<f64>) -> impl Fn(&Run) -> Option<String> {
    move |run| Some(format!("{:.3}", of(run.colmap.as_ref()?)?))
}

/// A table with the columns of the paper, and with COLMAP's if any run has a model of COLMAP.
/// `row_heading`: heading of the first column.
fn paper_table(caption: &str, row_heading: &str, runs: &[Run]) -> Table {
    let (dense_mean, dense_std) = (
        ours(|measured| Some(measured.dense.as_ref()?.distance.mean_m)),
        ours(|measured| Some(measured.dense.as_ref()?.distance.std_m)),
    );
    let (exact_dense_mean, exact_dense_std) = (
        ours(|measured| Some(measured.exact_dense.as_ref()?.distance.mean_m)),
        ours(|measured| Some(measured.exact_dense.as_ref()?.distance.std_m)),
    );
    let (mean, std) = (
        ours(|measured| Some(measured.cloud?.mean_m)),
        ours(|measured| Some(measured.cloud?.std_m)),
    );
    let exact_mean = ours(|measured| Some(measured.exact_cloud?.mean_m));
    let exact_std = ours(|measured| Some(measured.exact_cloud?.std_m));
    let (their_mean, their_std) = (
        colmap(|measured| Some(measured.cloud?.mean_m)),
        colmap(|measured| Some(measured.cloud?.std_m)),
    );
    let columns: [Column; 10] = [
        ("Dense", &dense_mean),
        ("true cameras", &exact_dense_mean),
        ("Sparse", &mean),
        (COLMAP, &their_mean),
        ("true cameras", &exact_mean),
        ("Dense", &dense_std),
        ("true cameras", &exact_dense_std),
        ("Sparse", &std),
        (COLMAP, &their_std),
        ("true cameras", &exact_std),
    ];
    let has_colmap = has_colmap(runs);
    let columns: Vec<Column> =
        columns.into_iter().filter(|(name, _)| has_colmap || *name != COLMAP).collect();
    let mut table = table(caption, "", runs, &columns);
    let mut above = vec![String::new(); columns.len() + 1];
    above[0] = row_heading.to_owned();
    above[1] = "Mean absolute distance [m]".to_owned();
    above[1 + columns.len() / 2] = "Std deviation [m]".to_owned();
    table.head.insert(0, above);
    table
}

fn has_colmap(runs: &[Run]) -> bool {
    runs.iter().any(|run| run.colmap.is_some())
}

/// A table of errors that need ground truth, with additional columns `more`.
fn ground_truth_table(row_heading: &str, runs: &[Run], more: &[Column]) -> Table {
    let ate = ours(|measured| Some(measured.ate_m));
    let (horizontal, vertical) =
        (ours(|measured| Some(measured.horizontal_m)), ours(|measured| Some(measured.vertical_m)));
    let (theirs, surface) =
        (colmap(|measured| Some(measured.ate_m)), ours(|measured| measured.surface_m));
    let registered =
        |run: &Run| Some(format!("{} of {}", run.colmap.as_ref()?.registered, run.images));
    let mut columns: Vec<Column> = vec![
        ("ATE [m]", &ate),
        ("horizontal", &horizontal),
        ("vertical", &vertical),
        ("Surface, median [m]", &surface),
    ];
    columns.extend(more);
    if has_colmap(runs) {
        let colmap: [Column; 2] = [("COLMAP: ATE [m]", &theirs), ("images", &registered)];
        columns.extend(colmap);
    }
    let last: [Column; 3] = [
        ("Points", &|run| Some(run.result.as_ref()?.points.to_string())),
        ("Models", &|run| Some(run.result.as_ref()?.models.to_string())),
        ("Time [s]", &|run| Some(format!("{:.0}", run.result.as_ref()?.seconds))),
    ];
    columns.extend(last);
    let mut table = table("Errors against ground truth", row_heading, runs, &columns);
    table.head[0].splice(1..1, ["Images".to_owned(), "Length [m]".to_owned()]);
    for ((_, values), run) in table.rows.iter_mut().zip(runs) {
        let registered = run.result.as_ref().map_or(0, |measured| measured.registered);
        values.splice(
            0..0,
            [format!("{registered} of {}", run.images), format!("{:.0}", run.driven_m)],
        );
    }
    for run in runs {
        if let Some(failure) = &run.failure {
            table.caption += &format!(". {}: {failure}", run.name);
        }
    }
    table
}

fn table(caption: &str, row_heading: &str, runs: &[Run], columns: &[Column]) -> Table {
    let row = |run: &Run| -> TableRow {
        let value = |column: &Column| column.1(run).unwrap_or_else(|| "-".to_owned());
        (run.name.clone(), columns.iter().map(value).collect())
    };
    let names: Vec<String> = columns.iter().map(|(name, _)| (*name).to_owned()).collect();
    let mut table = Table::of_columns(&names, runs.iter().map(row).collect());
    table.caption = caption.to_owned();
    table.head[0][0] = row_heading.to_owned();
    table
}

#[cfg(test)]
mod tests {
    use super::super::dense_cloud::DenseCloud;
    use super::super::distance::Distance;
    use super::*;

    fn of_dense(mean_m: f64, std_m: f64) -> DenseCloud {
        DenseCloud { distance: Distance { mean_m, std_m }, ..DenseCloud::default() }
    }

    fn run(name: &str, rig: RigMode, mean_m: f64, std_m: f64) -> Run {
        let result = Measurements {
            registered: 9,
            dense: Some(of_dense(mean_m, std_m)),
            exact_dense: Some(of_dense(0.03, 0.04)),
            cloud: Some(Distance { mean_m: 2.0 * mean_m, std_m: 2.0 * std_m }),
            exact_cloud: Some(Distance { mean_m: 0.01, std_m: 0.02 }),
            ate_m: mean_m / 10.0,
            baseline_m: Some(0.5),
            ..Measurements::default()
        };
        let rig = rig.name().to_owned();
        Run {
            name: name.to_owned(),
            rig,
            images: 10,
            driven_m: 99.6,
            result: Some(result),
            ..Run::default()
        }
    }

    /// The numbers are the paper's own.
    #[test]
    fn experiment_one_has_the_layout_of_table_3() {
        let mut runs = vec![
            run("Front", RigMode::Off, 1.253, 2.049),
            run("Right", RigMode::Off, 2.451, 4.285),
            run("Rear", RigMode::Off, 1.252, 2.052),
        ];
        let failure = Some("nothing overlaps".to_owned());
        runs.push(Run {
            name: "Left".to_owned(),
            images: 10,
            failure,
            result: None,
            ..runs[0].clone()
        });
        let [table, truth] = &view_directions(&runs)[..] else { panic!("two tables") };
        let expected = "\
| Camera configuration | Mean absolute distance [m] |  |  |  | Std deviation [m] |  |  |  |
|---|---|---|---|---|---|---|---|---|
|  | Dense | true cameras | Sparse | true cameras | Dense | true cameras | Sparse | true cameras |
| Front | 1.253 | 0.030 | 2.506 | 0.010 | 2.049 | 0.040 | 4.098 | 0.020 |
| Right | 2.451 | 0.030 | 4.902 | 0.010 | 4.285 | 0.040 | 8.570 | 0.020 |
| Rear | 1.252 | 0.030 | 2.504 | 0.010 | 2.052 | 0.040 | 4.104 | 0.020 |
| Left | - | - | - | - | - | - | - | - |
";
        assert!(table.to_markdown().ends_with(expected), "{}", table.to_markdown());
        let text = truth.to_markdown();
        assert!(
            text.contains("Left: nothing overlaps")
                && text.contains("| Front | 9 of 10 | 100 | 0.125 |"),
            "{text}"
        );
    }

    #[test]
    fn experiment_two_has_the_layout_of_table_4_and_the_improvement_of_the_paper() {
        let runs: Vec<Run> = [(RigMode::Off, 2.028, 2.965), (RigMode::Paper, 1.432, 2.105)]
            .map(|(rig, mean_m, std_m)| run(&row_of(rig), rig, mean_m, std_m))
            .to_vec();
        let [table, truth] = &of_constraints(&runs)[..] else { panic!("two tables") };
        let expected = "\
| BA | Mean absolute distance [m] |  |  |  | Std deviation [m] |  |  |  |
|---|---|---|---|---|---|---|---|---|
|  | Dense | true cameras | Sparse | true cameras | Dense | true cameras | Sparse | true cameras |
| Traditional (off) | 2.028 | 0.030 | 4.056 | 0.010 | 2.965 | 0.040 | 5.930 | 0.020 |
| Constrained (paper) | 1.432 | 0.030 | 2.864 | 0.010 | 2.105 | 0.040 | 4.210 | 0.020 |
";
        assert!(table.to_markdown().ends_with(expected), "{}", table.to_markdown());
        assert_eq!(truth.head[0].len(), truth.rows[0].1.len() + 1);
        // With COLMAP's results in the paper.
        let mut both = runs.clone();
        both[0].colmap = run("", RigMode::Off, 2.976, 3.690).result;
        let [table, with_colmap] = &of_constraints(&both)[..] else { panic!("two tables") };
        let text = table.to_markdown();
        assert!(
            text.contains("| BA | Mean absolute distance [m] |  |  |  |  | Std deviation [m] |"),
            "{text}"
        );
        assert!(
            text.contains("| Traditional (off) | 2.028 | 0.030 | 4.056 | 5.952 | 0.010 | 2.965 |"),
            "{text}"
        );
        assert!(
            text.contains("| Constrained (paper) | 1.432 | 0.030 | 2.864 | - | 0.010 | 2.105 |"),
            "{text}"
        );
        assert_eq!(with_colmap.head[0].len(), truth.head[0].len() + 2);
        // Section 4.3 of the paper has an improvement of 29.38 %, computed from unrounded numbers.
        assert!(truth.rows[1].1.contains(&"-29.39 %".to_owned()), "{truth:?}");
    }
}
