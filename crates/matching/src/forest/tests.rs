use proptest::prelude::*;
use tiepoint_features::SiftDescriptor;

use super::tree::NodeKind;
use super::*;
use crate::brute::{Isa, nearest};
use crate::matches::Nearest;
use crate::prepared::Prepared;

/// More leaves than the forests of these tests have.
const ALL: Checks = Checks::Total(1_000_000);

/// Points around a few centres: neighbours are much nearer than other points.
fn clustered(count: usize, seed: u64) -> Vec<SiftDescriptor> {
    let mut random = crate::random::stream(seed, 0);
    let mut centres = crate::random::stream(99, 0);
    let centres: Vec<SiftDescriptor> =
        (0..40).map(|_| std::array::from_fn(|_| centres.below(120) as u8)).collect();
    (0..count)
        .map(|_| {
            let centre = centres[random.below(centres.len())];
            centre.map(|x| x + random.below(60) as u8)
        })
        .collect()
}

fn exact(queries: &[SiftDescriptor], points: &[SiftDescriptor]) -> Vec<Nearest> {
    nearest(&Prepared::new(queries), &Prepared::new(points)).of_a
}

/// Checks that every point of the tree at `at` is on its side of all splits above. Collects the
/// points and returns the end of the nodes of the tree.
fn check_tree(
    forest: &Forest,
    at: u32,
    is_inside: &dyn Fn(&SiftDescriptor) -> bool,
    points: &mut Vec<u32>,
) -> u32 {
    match forest.nodes[at as usize].kind() {
        NodeKind::Inner { dimension, split, right } => {
            let left_end =
                check_tree(forest, at + 1, &|d| is_inside(d) && d[dimension] < split, points);
            assert_eq!(left_end, right);
            check_tree(forest, right, &|d| is_inside(d) && d[dimension] >= split, points)
        }
        NodeKind::Leaf { first, len } => {
            for &point in &forest.points[first..first + len] {
                assert!(is_inside(&forest.descriptors[point as usize].0));
                points.push(point);
            }
            at + 1
        }
    }
}

#[test]
fn every_tree_has_every_point_once_in_its_cell() {
    for count in [0, 1, 2, 8, 9, 100, 3000] {
        let forest = Forest::new(&clustered(count, 1), &ForestOptions { trees: 3, seed: 5 });
        assert_eq!(forest.trees(), 3);
        for &root in &forest.roots {
            let mut points = Vec::new();
            check_tree(&forest, root, &|_| true, &mut points);
            points.sort_unstable();
            assert_eq!(points, (0..count as u32).collect::<Vec<_>>());
        }
    }
}

#[test]
fn recall_grows_with_checks_and_with_trees() {
    let (queries, points) = (clustered(500, 2), clustered(4000, 3));
    let truth = exact(&queries, &points);
    let recall = |trees, checks| {
        let found =
            Forest::new(&points, &ForestOptions { trees, seed: 1 }).nearest(&queries, checks);
        found.iter().zip(&truth).filter(|(found, truth)| found.index == truth.index).count() as f64
            / 500.0
    };
    let by_checks = [8, 32, 128, 512].map(|checks| recall(8, Checks::Total(checks)));
    assert!(by_checks.is_sorted(), "{by_checks:?}");
    assert!(recall(8, Checks::Total(32)) > recall(1, Checks::Total(32)));
    assert_eq!(recall(4, Checks::PerTree(16)), recall(4, Checks::Total(64)));
    // The branch distances are estimates, so that even a search without limit can miss a neighbour.
    assert!(recall(8, ALL) > 0.99, "{}", recall(8, ALL));
}

#[test]
fn same_on_every_instruction_set_and_number_of_threads() {
    let (queries, points) = (clustered(200, 4), clustered(1500, 5));
    let options = ForestOptions::default();
    let expected = Forest::new(&points, &options).nearest(&queries, Checks::default());
    for isa in Isa::supported() {
        assert_eq!(
            Forest::new(&points, &options).nearest_on(isa, &queries, Checks::default()),
            expected,
            "{isa}"
        );
    }
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let forest = pool.install(|| Forest::new(&points, &options));
        assert_eq!(forest.nearest(&queries, Checks::default()), expected);
    }
    let other_seed = Forest::new(&points, &ForestOptions { seed: 1, ..options });
    assert_ne!(
        other_seed.nearest(&queries, Checks::Total(8)),
        Forest::new(&points, &options).nearest(&queries, Checks::Total(8))
    );
}

#[test]
fn equal_points_and_no_points() {
    // Equal points cannot be split.
    let equal = vec![[9; 128]; 1000];
    let found = Forest::new(&equal, &ForestOptions::default())
        .nearest(&[[9; 128], [0; 128]], Checks::Total(1));
    assert_eq!(found[0], Nearest { index: 0, distance: 0, second: 0 });
    assert_eq!(found[1], Nearest { index: 0, distance: 81 * 128, second: 81 * 128 });
    let none = Forest::new(&[], &ForestOptions { trees: 0, seed: 0 });
    assert!(none.is_empty());
    assert_eq!(none.nearest(&[[1; 128]], Checks::Total(0)), [Nearest::NONE]);
    let one = Forest::new(&[[2; 128]], &ForestOptions::default());
    assert_eq!(
        one.nearest(&[[1; 128]], Checks::default()),
        [Nearest { index: 0, distance: 128, second: u32::MAX }]
    );
    assert_eq!((one.len(), one.nearest(&[], ALL)), (1, vec![]));
}

#[test]
fn splits_nodes_whose_sample_is_equal() {
    // With 5000 equal points and 20 others, the first hundred points of a node are often equal.
    let mut points = vec![[50; 128]; 5000];
    points.extend(clustered(20, 6));
    let queries = clustered(20, 6);
    let found =
        Forest::new(&points, &ForestOptions::default()).nearest(&queries, Checks::default());
    assert!(
        found
            .iter()
            .enumerate()
            .all(|(i, found)| (found.index, found.distance) == (5000 + i as u32, 0))
    );
}

proptest! {
    /// For any points: distances are those of the returned index and not below the exact nearest
    /// distances.
    #[test]
    fn any_content(
        points in prop::collection::vec(prop::collection::vec(0u8..=255, 4), 0..60),
        queries in prop::collection::vec(prop::collection::vec(0u8..=255, 4), 0..10),
        trees in 1u32..5,
        checks in 0u32..20,
    ) {
        // Points differ in few dimensions, so that some are equal.
        let fill = |list: &[Vec<u8>]| {
            list.iter()
                .map(|d| std::array::from_fn(|k| if k < 4 { d[k] & 0x83 } else { 7 }))
                .collect::<Vec<SiftDescriptor>>()
        };
        let (points, queries) = (fill(&points), fill(&queries));
        let found = Forest::new(&points, &ForestOptions { trees, seed: 3 })
            .nearest(&queries, Checks::Total(checks));
        for ((found, truth), query) in found.iter().zip(exact(&queries, &points)).zip(&queries) {
            prop_assert!(found.distance >= truth.distance && found.second >= truth.second);
            // Two neighbours are found if there are two points.
            prop_assert_eq!(found.second == u32::MAX, points.len() < 2);
            if let Some(point) = points.get(found.index as usize) {
                let distance: i32 = query
                    .iter()
                    .zip(point)
                    .map(|(&x, &y)| (i32::from(x) - i32::from(y)).pow(2))
                    .sum();
                prop_assert_eq!(found.distance, distance as u32);
            }
        }
    }
}
