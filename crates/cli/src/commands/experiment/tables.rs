//! The tables: first as the paper has them, its rows, columns and units, then what else is known
//! here.

use tiepoint_pipeline::sfm::RigTerm;
use tiepoint_pipeline::{Table, TableRow};

use super::cell::{Cell, Measured};
use crate::args::rig_name;
use crate::commands::synth::BASELINE_M;

/// Experiment I.
pub(super) fn of_mountings(cells: &[Cell]) -> Vec<Table> {
    let caption = "Table 3 in the rendered world: accuracy for different mounting configurations \
    of monocular cameras (Experiment I)";
    let first = as_in_the_paper(caption, "Camera configuration", cells);
    let second = with_truth("Camera configuration", cells, &[]);
    vec![first, second]
}

/// Experiment II.
pub(super) fn of_constraints(cells: &[Cell]) -> Vec<Table> {
    let caption = "Table 4 in the rendered world: accuracy for two uncalibrated cameras that \
    overlap (Experiment II)";
    let traditional = cells
        .iter()
        .find(|cell| cell.rig == rig_name(RigTerm::Off))
        .and_then(|cell| cell.result.as_ref());
    let change = |of: fn(&Measured) -> Option<f64>| {
        move |cell: &Cell| {
            let (before, after) = (of(traditional?)?, of(cell.result.as_ref()?)?);
            Some(format!("{:+.2} %", 100.0 * (after / before - 1.0)))
        }
    };
    let in_distance = change(|measured| Some(measured.cloud?.mean_m));
    let in_ate = change(|measured| Some(measured.ate_m));
    let mounting = format!("Mounting (true {BASELINE_M:.3}) [m]");
    let (mounted, mean) =
        (ours(|measured| measured.mounting_m), ours(|measured| measured.baseline_m));
    let (largest, spread) =
        (ours(|measured| measured.largest_baseline_m), ours(|measured| measured.baseline_spread_m));
    let more: [Column; 6] = [
        (&mounting, &mounted),
        ("Pairs by stamps: distance, mean [m]", &mean),
        ("largest", &largest),
        ("spread", &spread),
        ("Distance, change", &in_distance),
        ("ATE, change", &in_ate),
    ];
    vec![as_in_the_paper(caption, "BA", cells), with_truth("BA", cells, &more)]
}

/// How the paper calls it, and what it is here.
pub(super) fn row_of(rig: RigTerm) -> String {
    match rig {
        RigTerm::Off => format!("Traditional ({})", rig_name(rig)),
        _ => format!("Constrained ({})", rig_name(rig)),
    }
}

/// A heading, and its value.
type Column<'a> = (&'a str, &'a dyn Fn(&Cell) -> Option<String>);

/// A number of ours, in metres.
fn ours(of: fn(&Measured) -> Option<f64>) -> impl Fn(&Cell) -> Option<String> {
    move |cell| Some(format!("{:.3}", of(cell.result.as_ref()?)?))
}

/// A number of COLMAP's.
fn colmap(of: fn(&Measured) -> Option<f64>) -> impl Fn(&Cell) -> Option<String> {
    move |cell| Some(format!("{:.3}", of(cell.colmap.as_ref()?)?))
}

/// COLMAP's columns are there where it has a model.
fn as_in_the_paper(caption: &str, what: &str, cells: &[Cell]) -> Table {
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
    let columns: [Column; 6] = [
        ("Ours", &mean),
        ("COLMAP", &their_mean),
        ("Exact cameras", &exact_mean),
        ("Ours", &std),
        ("COLMAP", &their_std),
        ("Exact cameras", &exact_std),
    ];
    let has_colmap = has_colmap(cells);
    let columns: Vec<Column> =
        columns.into_iter().filter(|(name, _)| has_colmap || *name != "COLMAP").collect();
    let mut table = table(caption, "", cells, &columns);
    let mut above = vec![String::new(); columns.len() + 1];
    above[0] = what.to_owned();
    above[1] = "Mean absolute distance [m]".to_owned();
    above[1 + columns.len() / 2] = "Std deviation [m]".to_owned();
    table.head.insert(0, above);
    table
}

fn has_colmap(cells: &[Cell]) -> bool {
    cells.iter().any(|cell| cell.colmap.is_some())
}

fn with_truth(what: &str, cells: &[Cell], more: &[Column]) -> Table {
    let ate = ours(|measured| Some(measured.ate_m));
    let (horizontal, vertical) =
        (ours(|measured| Some(measured.horizontal_m)), ours(|measured| Some(measured.vertical_m)));
    let (theirs, surface) =
        (colmap(|measured| Some(measured.ate_m)), ours(|measured| measured.surface_m));
    let registered =
        |cell: &Cell| Some(format!("{} of {}", cell.colmap.as_ref()?.registered, cell.images));
    let mut columns: Vec<Column> = vec![
        ("ATE [m]", &ate),
        ("horizontal", &horizontal),
        ("vertical", &vertical),
        ("Surface, median [m]", &surface),
    ];
    columns.extend(more);
    if has_colmap(cells) {
        let colmap: [Column; 2] = [("COLMAP: ATE [m]", &theirs), ("images", &registered)];
        columns.extend(colmap);
    }
    let last: [Column; 3] = [
        ("Points", &|cell| Some(cell.result.as_ref()?.points.to_string())),
        ("Models", &|cell| Some(cell.result.as_ref()?.models.to_string())),
        ("Time [s]", &|cell| Some(format!("{:.0}", cell.result.as_ref()?.seconds))),
    ];
    columns.extend(last);
    let mut table = table("Against the truth", what, cells, &columns);
    table.head[0].splice(1..1, ["Images".to_owned(), "Way [m]".to_owned()]);
    for ((_, values), cell) in table.rows.iter_mut().zip(cells) {
        let registered = cell.result.as_ref().map_or(0, |measured| measured.registered);
        values.splice(
            0..0,
            [format!("{registered} of {}", cell.images), format!("{:.0}", cell.driven_m)],
        );
    }
    for cell in cells {
        if let Some(failure) = &cell.failure {
            table.caption += &format!(". {}: {failure}", cell.name);
        }
    }
    table
}

fn table(caption: &str, what: &str, cells: &[Cell], columns: &[Column]) -> Table {
    let row = |cell: &Cell| -> TableRow {
        let value = |column: &Column| column.1(cell).unwrap_or_else(|| "-".to_owned());
        (cell.name.clone(), columns.iter().map(value).collect())
    };
    let names: Vec<String> = columns.iter().map(|(name, _)| (*name).to_owned()).collect();
    let mut table = Table::of_columns(&names, cells.iter().map(row).collect());
    table.caption = caption.to_owned();
    table.head[0][0] = what.to_owned();
    table
}

#[cfg(test)]
mod tests {
    use super::super::cell::Distance;
    use super::*;

    fn cell(name: &str, rig: RigTerm, mean_m: f64, std_m: f64) -> Cell {
        let result = Measured {
            registered: 9,
            cloud: Some(Distance { mean_m, std_m }),
            exact_cloud: Some(Distance { mean_m: 0.01, std_m: 0.02 }),
            ate_m: mean_m / 10.0,
            baseline_m: Some(0.5),
            ..Measured::default()
        };
        let rig = rig_name(rig).to_owned();
        Cell {
            name: name.to_owned(),
            rig,
            images: 10,
            driven_m: 99.6,
            result: Some(result),
            ..Cell::default()
        }
    }

    /// The numbers are the paper's own.
    #[test]
    fn experiment_one_is_laid_out_as_table_3() {
        let mut cells = vec![
            cell("Front", RigTerm::Off, 1.253, 2.049),
            cell("Right", RigTerm::Off, 2.451, 4.285),
            cell("Rear", RigTerm::Off, 1.252, 2.052),
        ];
        let failure = Some("nothing overlaps".to_owned());
        cells.push(Cell {
            name: "Left".to_owned(),
            images: 10,
            failure,
            result: None,
            ..cells[0].clone()
        });
        let [table, truth] = &of_mountings(&cells)[..] else { panic!("two tables") };
        let expected = "\
| Camera configuration | Mean absolute distance [m] |  | Std deviation [m] |  |
|---|---|---|---|---|
|  | Ours | Exact cameras | Ours | Exact cameras |
| Front | 1.253 | 0.010 | 2.049 | 0.020 |
| Right | 2.451 | 0.010 | 4.285 | 0.020 |
| Rear | 1.252 | 0.010 | 2.052 | 0.020 |
| Left | - | - | - | - |
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
    fn experiment_two_is_laid_out_as_table_4_and_has_the_papers_improvement() {
        let cells: Vec<Cell> = [(RigTerm::Off, 2.028, 2.965), (RigTerm::Paper, 1.432, 2.105)]
            .map(|(rig, mean_m, std_m)| cell(&row_of(rig), rig, mean_m, std_m))
            .to_vec();
        let [table, truth] = &of_constraints(&cells)[..] else { panic!("two tables") };
        let expected = "\
| BA | Mean absolute distance [m] |  | Std deviation [m] |  |
|---|---|---|---|---|
|  | Ours | Exact cameras | Ours | Exact cameras |
| Traditional (off) | 2.028 | 0.010 | 2.965 | 0.020 |
| Constrained (paper) | 1.432 | 0.010 | 2.105 | 0.020 |
";
        assert!(table.to_markdown().ends_with(expected), "{}", table.to_markdown());
        assert_eq!(truth.head[0].len(), truth.rows[0].1.len() + 1);
        // With COLMAP's models, as the paper has them.
        let mut both = cells.clone();
        both[0].colmap = cell("", RigTerm::Off, 2.976, 3.690).result;
        let [table, with_colmap] = &of_constraints(&both)[..] else { panic!("two tables") };
        let text = table.to_markdown();
        assert!(
            text.contains("| BA | Mean absolute distance [m] |  |  | Std deviation [m] |  |  |"),
            "{text}"
        );
        assert!(
            text.contains("| Traditional (off) | 2.028 | 2.976 | 0.010 | 2.965 | 3.690 | 0.020 |"),
            "{text}"
        );
        assert!(
            text.contains("| Constrained (paper) | 1.432 | - | 0.010 | 2.105 | - | 0.020 |"),
            "{text}"
        );
        assert_eq!(with_colmap.head[0].len(), truth.head[0].len() + 2);
        // Section 4.3: an improvement of 29.38 %; the paper's own rounding gives the last digit.
        assert!(truth.rows[1].1.contains(&"-29.39 %".to_owned()), "{truth:?}");
    }
}
