//! Options out of their range are refused by name.

use tiepoint_adjust::AdjustOptions;
use tiepoint_geometry::Loss;

/// Values that no option has.
const WRONG: [f64; 3] = [-1.0, f64::NAN, f64::INFINITY];

/// The pattern names all fields, so that a new option does not compile until it is here.
fn set(name: &str, value: f64) -> AdjustOptions<'static> {
    let AdjustOptions {
        refine,
        refine_calibrated,
        select_tracks,
        mut loss,
        mut principal_point_sigma,
        mut distortion_sigma,
        mut noise,
        focal_priors,
        gauge,
        constant_poses,
        constant_rigs,
        max_iterations,
        mut function_tolerance,
    } = AdjustOptions::default();
    match name {
        "loss scale" => loss = Loss::Huber(value),
        "principal_point_sigma" => principal_point_sigma = value,
        "distortion_sigma" => distortion_sigma = value,
        "noise" => noise = value,
        _ => function_tolerance = value,
    }
    AdjustOptions {
        refine,
        refine_calibrated,
        select_tracks,
        loss,
        principal_point_sigma,
        distortion_sigma,
        noise,
        focal_priors,
        gauge,
        constant_poses,
        constant_rigs,
        max_iterations,
        function_tolerance,
    }
}

#[test]
fn wrong_options_are_refused_by_name() {
    AdjustOptions::default().validate().unwrap();
    for name in
        ["loss scale", "principal_point_sigma", "distortion_sigma", "noise", "function_tolerance"]
    {
        for value in WRONG {
            assert_eq!(set(name, value).validate().unwrap_err().name, name, "{value}");
        }
        let allows_zero = name == "function_tolerance";
        assert_eq!(set(name, 0.0).validate().is_ok(), allows_zero, "{name}");
    }
}
