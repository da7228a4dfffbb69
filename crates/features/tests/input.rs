//! Degenerate images and invalid arguments.

use tiepoint_features::{DomainSizes, Error, GrayView, Options, Orientation, Sift, extract};

#[test]
fn degenerate_images_have_no_features() {
    let sides = [0, 1, 2, 3];
    let small = sides.into_iter().flat_map(|width| sides.map(|height| (width, height)));
    let default = Options::default();
    let pooled = Options { domain_sizes: Some(DomainSizes::default()), ..default };
    let options_list = [
        default,
        pooled,
        Options { first_octave: 0, orientation: Orientation::Upright, ..default },
    ];
    for (width, height) in small.chain([(0, 7), (1, 100_000), (100_000, 1), (64, 64), (300, 200)]) {
        for (grey, options) in
            [0, 77, 255].into_iter().flat_map(|grey| options_list.map(|options| (grey, options)))
        {
            let pixels = vec![grey; width * height];
            let features = extract(&GrayView::new(&pixels, width, height), &options);
            assert_eq!(features.map(|f| f.keypoints.len()), Ok(0), "{width}x{height} {options:?}");
        }
    }
}

#[test]
fn invalid_views_are_errors() {
    let pixels = vec![0; 100];
    let too_short = extract(&GrayView::new(&pixels, 10, 11), &Options::default());
    assert_eq!(
        too_short,
        Err(Error::ViewTooShort { width: 10, height: 11, stride: 10, needed: 110, len: 100 })
    );
    let overlap = GrayView { data: &pixels, width: 10, height: 10, stride: 9 };
    assert_eq!(
        extract(&overlap, &Options::default()),
        Err(Error::StrideTooSmall { width: 10, stride: 9 })
    );
    let (image, mask) = (GrayView::new(&pixels, 10, 10), GrayView::new(&pixels, 20, 5));
    let sizes = Error::MaskSize { width: 10, height: 10, mask_width: 20, mask_height: 5 };
    assert_eq!(
        Sift::new(Options::default()).and_then(|mut s| s.extract(&image, Some(&mask))),
        Err(sizes)
    );
}

#[test]
fn options_out_of_range_are_errors() {
    let default = Options::default();
    for wrong in [
        Options { first_octave: -2, ..default },
        Options { octaves: 0, ..default },
        Options { levels: 9, ..default },
        Options { max_orientations: 0, ..default },
        Options { peak_threshold: f32::NAN, ..default },
        Options { edge_threshold: 0.5, ..default },
        Options {
            domain_sizes: Some(DomainSizes { min: f32::NAN, ..Default::default() }),
            ..default
        },
        Options { domain_sizes: Some(DomainSizes { max: 0.1, ..Default::default() }), ..default },
        Options { domain_sizes: Some(DomainSizes { count: 0, ..Default::default() }), ..default },
    ] {
        assert!(matches!(Sift::new(wrong).err(), Some(Error::Option { .. })), "{wrong:?}");
    }
}
