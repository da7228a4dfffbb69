//! Comparison with a reference implementation, between instruction sets, and with known keypoints.

use std::num::NonZeroUsize;

use proptest::prelude::*;

use crate::bands::{OctaveJob, compute_octave};
use crate::buffer::AlignedBuf;
use crate::describe::describe_extrema;
use crate::extrema::{Extremum, Thresholds};
use crate::octave::OctavePlan;
use crate::simd::Isa;
use crate::source::Source;
use crate::{DomainSizes, Features, GrayView, Limit, Options, Orientation, Sift};

mod reference;
use reference::*;

/// Deterministic texture: blobs of many sizes and some noise, so that every octave has extrema.
fn texture(width: usize, height: usize, seed: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    let mut image = vec![110.0f32; width * height];
    let blobs = width * height / 40 + 3;
    for _ in 0..blobs {
        let (cx, cy) = (random() * width as f32, random() * height as f32);
        let sigma = 0.8 * (12.0f32).powf(random() * random());
        let (stretch, height_of) = (0.6 + 0.8 * random(), 200.0 * (random() - 0.5));
        let reach = (3.0 * sigma * stretch.max(1.0)).ceil();
        let (x0, x1) = ((cx - reach).max(0.0) as usize, ((cx + reach) as usize).min(width - 1));
        let (y0, y1) = ((cy - reach).max(0.0) as usize, ((cy + reach) as usize).min(height - 1));
        for y in y0..=y1 {
            for x in x0..=x1 {
                let (dx, dy) = ((x as f32 - cx) / (sigma * stretch), (y as f32 - cy) / sigma);
                image[y * width + x] += height_of * (-0.5 * (dx * dx + dy * dy)).exp();
            }
        }
    }
    image.iter().map(|&v| (v + 4.0 * (random() - 0.5)).clamp(0.0, 255.0) as u8).collect()
}

fn sift(features: &Features) -> &[crate::SiftDescriptor] {
    features.descriptors.as_sift().unwrap()
}

fn extract_on(isa: Isa, options: Options, view: &GrayView<'_>) -> Features {
    let mut sift = Sift::new(options).unwrap();
    sift.isa = isa;
    sift.extract(view, None).unwrap()
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let (width, height) = (211, 157);
    let image = texture(width, height, 3);
    let view = GrayView::new(&image, width, height);
    let options = Options { max_features: 100_000, ..Options::default() };
    let portable = extract_on(Isa::PORTABLE, options, &view);
    assert!(portable.keypoints.len() > 300, "{}", portable.keypoints.len());
    let pooled = Options { domain_sizes: Some(DomainSizes::default()), ..options };
    let portable_pooled = extract_on(Isa::PORTABLE, pooled, &view);
    // The same keypoints in the same order, without duplicates.
    let mut all = portable.keypoints.iter().zip(sift(&portable));
    let own_descriptor = |keypoint| all.find(|own| own.0 == keypoint).unwrap().1;
    let own: Vec<&crate::SiftDescriptor> =
        portable_pooled.keypoints.iter().map(own_descriptor).collect();
    assert!(own.len() > portable.keypoints.len() * 9 / 10 && own.len() < portable.keypoints.len());
    assert!(own.iter().zip(sift(&portable_pooled)).all(|(&own, pooled)| own != pooled));
    for isa in Isa::available() {
        assert!(extract_on(isa, options, &view) == portable, "{isa:?}");
        assert!(extract_on(isa, pooled, &view) == portable_pooled, "{isa:?}");
    }
}

/// Runs every kernel on an image small enough for Miri and sanitizers, of odd size, so that vectors
/// extend beyond the last sample.
#[test]
fn every_kernel_on_a_small_image() {
    let (width, height) = if cfg!(miri) { (13, 11) } else { (29, 23) };
    let image = texture(width, height, 9);
    let view = GrayView::new(&image, width, height);
    // Under Miri, which takes milliseconds for each sample of a window, two keypoints and sizes.
    let plain = Options { max_features: if cfg!(miri) { 2 } else { 8192 }, ..Options::default() };
    let count = if cfg!(miri) { 2 } else { 10 };
    let pooled =
        Options { domain_sizes: Some(DomainSizes { count, ..Default::default() }), ..plain };
    for options in [plain, pooled] {
        let portable = extract_on(Isa::PORTABLE, options, &view);
        assert!(!portable.keypoints.is_empty());
        for isa in Isa::available() {
            assert!(extract_on(isa, options, &view) == portable, "{isa:?}");
        }
    }
}

#[test]
fn results_do_not_depend_on_threads_and_reused_memory() {
    // Wide enough for several tiles, high enough for several bands.
    let (width, height) = (1400, 700);
    let image = texture(width, height, 5);
    let view = GrayView::new(&image, width, height);
    let mut sift = Sift::new(Options::default()).unwrap();
    let one = sift.extract(&view, None).unwrap();
    assert!(one.keypoints.len() > 1000);
    for threads in [2, 3, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(
            pool.install(|| sift.extract_parallel(&view, None)).unwrap() == one,
            "{threads} threads"
        );
    }
    // Levels that are not stored are computed again, in parts.
    sift.max_level_bytes = 4 << 20;
    assert!(sift.extract(&view, None).unwrap() == one);
    assert!(sift.extract_parallel(&view, None).unwrap() == one);
    let small = GrayView { data: &image, width: 97, height: 61, stride: width };
    let fresh = Sift::new(Options::default()).unwrap().extract(&small, None).unwrap();
    assert!(sift.extract(&small, None).unwrap() == fresh);
    assert!(!fresh.keypoints.is_empty());
    // The largest windows of DSP-SIFT extend far beyond the rows of a part.
    let pooled = Options { domain_sizes: Some(DomainSizes::default()), ..Options::default() };
    let mut sift = Sift::new(pooled).unwrap();
    let middling = GrayView { data: &image, width: 190, height: 140, stride: width };
    let one = sift.extract(&middling, None).unwrap();
    sift.max_level_bytes = 1 << 18;
    assert!(sift.extract_parallel(&middling, None).unwrap() == one);
}

/// Computes the levels and extrema of an octave.
fn octave_levels_and_extrema(
    view: &GrayView<'_>,
    octave: i32,
    thresholds: Thresholds,
    isa: Isa,
) -> (Vec<Plane>, Vec<Extremum>) {
    let (size, source) = if octave < 0 {
        ((2 * view.width, 2 * view.height), Source::Doubled(*view))
    } else {
        ((view.width, view.height), Source::Image(*view))
    };
    let plan = OctavePlan::new(octave, size, 3, Some(-1));
    let mut bufs = Vec::new();
    let found = compute_octave(OctaveJob {
        plan: &plan,
        source,
        rows: 0..size.1,
        levels: Some(&mut bufs),
        next_octave: None,
        thresholds: Some(thresholds),
        scratches: &mut Vec::new(),
        isa,
        threads: NonZeroUsize::MIN,
    });
    let plane = |b: &AlignedBuf| {
        Plane::from_fn(size.0, size.1, |x, y| {
            f64::from(b.as_slice()[y as usize * plan.stride() + x as usize])
        })
    };
    (bufs.iter().map(plane).collect(), found)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]

    #[test]
    fn levels_match_direct_convolution(
        width in 8usize..90,
        height in 8usize..70,
        doubled in any::<bool>(),
        seed in any::<u64>(),
    ) {
        // 100 sums of products in single precision, values up to 1.
        const TOLERANCE: f64 = 2e-6;
        let image = texture(width, height, seed);
        let view = GrayView::new(&image, width, height);
        let octave = if doubled { -1 } else { 0 };
        let reference = reference_levels(&reference_source(&view, octave), octave, 3);
        for isa in Isa::available() {
            let thresholds = Thresholds { peak: 0.01, edge: 10.0 };
            let (levels, _) = octave_levels_and_extrema(&view, octave, thresholds, isa);
            for (level, reference) in levels.iter().zip(&reference[1..]) {
                let worst = level
                    .data
                    .iter()
                    .zip(&reference.data)
                    .map(|(a, b)| (a - b).abs())
                    .fold(0.0, f64::max);
                prop_assert!(worst < TOLERANCE, "{isa:?}: {worst}");
            }
        }
    }
}

#[test]
fn extrema_match_the_reference() {
    const PEAK: f32 = 0.004;
    const EDGE: f32 = 10.0;
    /// Differences of levels have errors of 1e-7 in single precision, and curvatures from 1e-3.
    const TOLERANCE: f64 = 5e-3;
    let (width, height) = (150, 110);
    let image = texture(width, height, 11);
    let view = GrayView::new(&image, width, height);
    let planes = reference_levels(&reference_source(&view, 0), 0, 3);
    let (peak, edge) = (f64::from(PEAK), f64::from(EDGE));
    let (_, found) =
        octave_levels_and_extrema(&view, 0, Thresholds { peak: PEAK, edge: EDGE }, Isa::best());
    let mut num_expected = 0;
    for candidate in reference_extrema(&planes, peak * 0.8) {
        let Some([ix, iy, x, y, value]) = reference_refined(&planes, candidate, peak, edge) else {
            continue;
        };
        num_expected += 1;
        let matched =
            found.iter().find(|e| (e.level, e.ix as f64, e.iy as f64) == (candidate.0, ix, iy));
        let matched = matched.unwrap_or_else(|| panic!("{candidate:?} is missing"));
        assert!(
            (f64::from(matched.x) - x).abs() < TOLERANCE
                && (f64::from(matched.y) - y).abs() < TOLERANCE,
            "{matched:?}"
        );
        assert!((f64::from(matched.response) - value).abs() < TOLERANCE * peak, "{matched:?}");
    }
    assert!(
        num_expected > 50 && found.len() == num_expected,
        "{} found, {num_expected} expected",
        found.len()
    );
}

#[test]
fn orientations_and_descriptors_match_the_reference() {
    /// In radians. The smoothed histogram is flat at its maxima, and sums are in single precision.
    const ANGLE_TOLERANCE: f64 = 1e-3;
    /// Rounding to bytes, and single precision before the square root.
    const BYTE_TOLERANCE: f64 = 0.7;
    let (width, height) = (150, 110);
    let image = texture(width, height, 17);
    let view = GrayView::new(&image, width, height);
    let thresholds = Thresholds { peak: 0.004, edge: 10.0 };
    let (planes, found) = octave_levels_and_extrema(&view, 0, thresholds, Isa::best());
    let plan = OctavePlan::new(0, (width, height), 3, Some(-1));
    let levels: Vec<Vec<f32>> = planes
        .iter()
        .map(|plane| {
            let mut data = vec![0.0; plan.level_len(height)];
            for y in 0..height {
                for x in 0..width {
                    data[y * plan.stride() + x] = plane.data[y * width + x] as f32;
                }
            }
            data
        })
        .collect();
    let levels: Vec<&[f32]> = levels.iter().map(Vec::as_slice).collect();
    let (mut several, mut compared, mut pooled) = (0, 0, 0);
    let pooling = DomainSizes { min: 0.25, max: 1.75, count: 3 };
    for (isa, sizes) in
        Isa::available().into_iter().flat_map(|isa| [(isa, None), (isa, Some(pooling))])
    {
        let options = Options { max_orientations: 4, domain_sizes: sizes, ..Options::default() };
        let sizes: &[f64] = if sizes.is_some() { &[0.25, 0.75, 1.25] } else { &[1.0] };
        let all = describe_extrema(&found, &plan, &levels, 0, &options, isa, NonZeroUsize::MIN);
        for (e, description) in found.iter().zip(&all) {
            let (at, sigma) = ((f64::from(e.x), f64::from(e.y)), f64::from(e.sigma));
            let plane = &planes[e.level - 1];
            let directions = reference_directions(plane, at, sigma);
            // Skips extrema with maxima at the threshold or of equal height, which rounding
            // decides.
            let highest = directions[0].1;
            let clear = directions.iter().all(|d| (d.1 / highest - 0.8).abs() > 1e-4)
                && directions.windows(2).all(|pair| pair[0].1 - pair[1].1 > 1e-4 * highest);
            if !clear {
                continue;
            }
            let angles = description.orientations.as_slice();
            assert_eq!(angles.len(), directions.len(), "{e:?}");
            several += usize::from(angles.len() > 1);
            for ((&angle, descriptor), reference) in
                angles.iter().zip(&description.descriptors).zip(&directions)
            {
                assert!(
                    (f64::from(angle) - reference.0).abs() < ANGLE_TOLERANCE,
                    "{angle} {reference:?}"
                );
                let expected = reference_descriptor(plane, at, sigma, f64::from(angle), sizes);
                for (&byte, expected) in descriptor.iter().zip(expected) {
                    assert!(
                        (f64::from(byte) - expected).abs() < BYTE_TOLERANCE,
                        "{byte} {expected}"
                    );
                }
                compared += 1;
                pooled += usize::from(sizes.len() > 1);
            }
        }
    }
    assert!(
        pooled > 100 && compared == 2 * pooled && several > 10,
        "{compared} {pooled} {several}"
    );
}

/// An image of a Gaussian blob with known centre and σ, in pixels.
fn blob(width: usize, height: usize, centre: (f32, f32), sigma: f32) -> Vec<u8> {
    let value = |i: usize| {
        let (x, y) = ((i % width) as f32 + 0.5 - centre.0, (i / width) as f32 + 0.5 - centre.1);
        30.0 + 200.0 * (-0.5 * (x * x + y * y) / (sigma * sigma)).exp()
    };
    (0..width * height).map(|i| value(i).round() as u8).collect()
}

#[test]
fn detects_blobs_at_their_position_and_scale() {
    /// Rounding of pixels to bytes, and the error of the interpolation.
    const POSITION_TOLERANCE: f32 = 0.03;
    /// The difference of Gaussians responds most at √(σ² + 0.25) / 2^(1/6): half a level below the
    /// blob's own scale.
    const SCALE_TOLERANCE: f32 = 0.05;
    for (x, y, sigma) in
        [(60.5, 50.5, 2.0), (61.2, 49.3, 3.3), (59.85, 50.0, 6.0), (60.0, 52.0, 9.0)]
    {
        let image = blob(121, 101, (x, y), sigma);
        let features = Sift::new(Options::default())
            .unwrap()
            .extract(&GrayView::new(&image, 121, 101), None)
            .unwrap();
        let expected = (sigma * sigma + 0.25).sqrt() / 2f32.powf(1.0 / 6.0);
        let best = features
            .keypoints
            .iter()
            .find(|k| (k.scale / expected - 1.0).abs() < SCALE_TOLERANCE)
            .unwrap_or_else(|| panic!("no keypoint of scale {expected}: {:?}", features.keypoints));
        assert!(
            (best.x - x).abs() < POSITION_TOLERANCE && (best.y - y).abs() < POSITION_TOLERANCE,
            "{best:?}"
        );
    }
}

/// The image rotated clockwise by 90 degrees: (x, y) maps to (height − y, x).
fn rotated(image: &[u8], width: usize, height: usize) -> Vec<u8> {
    (0..width * height).map(|i| image[(height - 1 - i % height) * width + i / height]).collect()
}

#[test]
fn rotation_by_90_degrees_rotates_keypoints_and_keeps_descriptors() {
    let (width, height) = (160, 160);
    let image = texture(width, height, 21);
    let other = rotated(&image, width, height);
    // Only octave 0 is symmetric: others subsample or repeat the last sample.
    let options = Options { first_octave: 0, octaves: 1, ..Options::default() };
    let a = extract_on(Isa::best(), options, &GrayView::new(&image, width, height));
    let b = extract_on(Isa::best(), options, &GrayView::new(&other, height, width));
    let (mut found, mut same) = (0, 0);
    for (k, d) in a.keypoints.iter().zip(sift(&a)) {
        let (x, y) = (height as f32 - k.y, k.x);
        let angle = k.orientation + std::f32::consts::FRAC_PI_2;
        let matched = b.keypoints.iter().position(|t| {
            let difference = (t.orientation - angle).rem_euclid(std::f32::consts::TAU);
            (t.x - x).hypot(t.y - y) < 0.01
                && (t.scale / k.scale - 1.0).abs() < 1e-3
                && !(0.01..6.27).contains(&difference)
        });
        if let Some(matched) = matched {
            found += 1;
            same +=
                usize::from(d.iter().zip(&sift(&b)[matched]).all(|(&p, &q)| p.abs_diff(q) <= 3));
        }
    }
    assert!(
        a.keypoints.len() > 50 && found * 10 > a.keypoints.len() * 9,
        "{found} of {}",
        a.keypoints.len()
    );
    assert!(same * 10 >= found * 9, "{same} of {found}");
}

#[test]
fn masks_and_limits_select_keypoints() {
    let (width, height) = (200, 150);
    let image = texture(width, height, 8);
    let view = GrayView::new(&image, width, height);
    let mask: Vec<u8> =
        (0..width * height).map(|i| if i % width < 100 { 255 } else { 0 }).collect();
    let all = Sift::new(Options::default()).unwrap().extract(&view, None).unwrap();
    let masked = Sift::new(Options::default())
        .unwrap()
        .extract(&view, Some(&GrayView::new(&mask, width, height)));
    let masked = masked.unwrap();
    let left: Vec<_> = all.keypoints.iter().filter(|k| k.x < 100.0).collect();
    assert!(!left.is_empty() && left.len() < all.keypoints.len());
    assert_eq!(masked.keypoints.iter().collect::<Vec<_>>(), left);
    for max_features in [0, 1, 50, 51] {
        let exact = Options { max_features, limit: Limit::Exact, ..Options::default() };
        let few = extract_on(Isa::best(), exact, &view);
        // The coarsest features, whether or not the doubled octave was computed.
        assert_eq!(few.keypoints, all.keypoints[..max_features]);
        assert_eq!(sift(&few), &sift(&all)[..max_features]);
        let levels = extract_on(Isa::best(), Options { max_features, ..Options::default() }, &view);
        assert_eq!(levels.keypoints, all.keypoints[..levels.keypoints.len()]);
        assert!(
            levels.keypoints.len() > max_features && levels.keypoints.len() < all.keypoints.len()
        );
    }
}

#[test]
fn upright_features_and_all_numbers_of_levels() {
    let (width, height) = (150, 130);
    let image = texture(width, height, 9);
    let view = GrayView::new(&image, width, height);
    let default = Options::default();
    let upright =
        extract_on(Isa::best(), Options { orientation: Orientation::Upright, ..default }, &view);
    assert!(
        upright.keypoints.iter().all(|k| k.orientation == 0.0) && !upright.keypoints.is_empty()
    );
    for levels in 1..=8 {
        for first_octave in [-1, 0, 1] {
            let options = Options { levels, first_octave, ..default };
            let features = extract_on(Isa::best(), options, &view);
            // Refinement can move the scale from level 1 to half a level below level 0.
            let finest = 1.6 * 2f32.powf(first_octave as f32 - 0.5 / levels as f32);
            assert!(!features.keypoints.is_empty(), "{levels} levels from octave {first_octave}");
            assert!(features.keypoints.iter().all(|k| k.scale > finest), "{levels} {first_octave}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn keypoints_are_inside_images_of_any_size(
        width in 1usize..70,
        height in 1usize..70,
        seed in any::<u64>(),
        noise in any::<bool>(),
    ) {
        let image = if noise {
            (0..(width * height) as u64)
                .map(|i| ((i ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8)
                .collect()
        } else {
            texture(width, height, seed)
        };
        let features =
            extract_on(Isa::best(), Options::default(), &GrayView::new(&image, width, height));
        prop_assert_eq!(features.keypoints.len(), features.descriptors.len());
        for k in &features.keypoints {
            prop_assert!(k.x >= 0.0 && k.x <= width as f32 && k.y >= 0.0 && k.y <= height as f32);
            prop_assert!(k.scale > 0.0 && k.orientation.abs() <= std::f32::consts::PI);
        }
        for d in sift(&features) {
            // Norm 512, with a rounding error of up to one half per value.
            let norm = d.iter().map(|&v| f32::from(v).powi(2)).sum::<f32>().sqrt();
            prop_assert!((norm - 512.0).abs() < 6.0 || norm == 0.0, "{}", norm);
        }
    }
}
