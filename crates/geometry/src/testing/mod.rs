//! Invariants ("laws") of manifolds, camera models, losses, Jacobians and solvers, as functions of
//! values for property tests. `Err` holds a message with the violated invariant and the values.

mod solver_laws;

use nalgebra::{SVector, Vector3};

use crate::{Block, CameraModel, Intrinsics, Loss, Manifold};
pub use solver_laws::{SolverProblem, SolverTrial, solver_problem};

/// Step h of numeric differentiation in the tangent space, relative to the size of the value. The
/// error of the five-point rule is of order h⁴ times the fifth derivative plus ε/h: about 1e-12 for
/// functions of unit size.
const STEP: f64 = 1e-3;

/// Tolerance of analytic against numeric derivatives, relative to the largest entry of the column.
const DERIVATIVE_TOLERANCE: f64 = 1e-7;

/// Tolerance of round trips, relative to values of unit size.
const ROUND_TRIP_TOLERANCE: f64 = 1e-9;

/// The Jacobian d residual / d x at `x` with respect to `plus` at zero, by the five-point rule with
/// `step` in every tangent direction. `None` if the residual is undefined at a sampled value.
pub fn numeric_jacobian<V: Manifold, const R: usize>(
    x: &V,
    step: f64,
    residual: impl Fn(&V) -> Option<SVector<f64, R>>,
) -> Option<V::Jacobian<R>> {
    let mut jacobian = V::Jacobian::<R>::zeros();
    for column in 0..V::DOF {
        let at = |t: f64| {
            let mut delta = V::Tangent::zeros();
            delta.as_mut_slice()[column] = t;
            residual(&x.plus(&delta))
        };
        let derivative =
            ((at(step)? - at(-step)?) * 8.0 - (at(2.0 * step)? - at(-2.0 * step)?)) / (12.0 * step);
        jacobian.as_mut_slice()[column * R..(column + 1) * R]
            .copy_from_slice(derivative.as_slice());
    }
    Some(jacobian)
}

/// Checks that `analytic` is the Jacobian of `residual` with respect to `plus` at zero. If the
/// residual is undefined at a sampled value, nothing is checked.
///
/// # Errors
/// A message with the column that differs from the numeric derivative.
pub fn jacobian_law<V: Manifold, const R: usize>(
    x: &V,
    analytic: &V::Jacobian<R>,
    step: f64,
    residual: impl Fn(&V) -> Option<SVector<f64, R>>,
) -> Result<(), String> {
    let Some(numeric) = numeric_jacobian(x, step, residual) else { return Ok(()) };
    for (column, (a, n)) in
        analytic.as_slice().chunks(R).zip(numeric.as_slice().chunks(R)).enumerate()
    {
        let size = a.iter().chain(n).fold(1.0, |size: f64, value| size.max(value.abs()));
        let same = a.iter().zip(n).all(|(a, n)| (a - n).abs() <= DERIVATIVE_TOLERANCE * size);
        if !same {
            return Err(format!(
                "Jacobian column {column} at {x:?}: analytic {a:?}, numeric {n:?}"
            ));
        }
    }
    Ok(())
}

/// Checks the invariants of [`Manifold`] at `x` and `y`, for a tangent vector `delta` that is
/// shorter than the injectivity radius.
///
/// # Errors
/// A message with the violated invariant.
pub fn manifold_laws<V: Manifold>(x: &V, y: &V, delta: &V::Tangent) -> Result<(), String> {
    let near = |a: V::Tangent, b: V::Tangent| {
        a.as_slice()
            .iter()
            .zip(b.as_slice())
            .all(|(a, b)| (a - b).abs() <= ROUND_TRIP_TOLERANCE * (1.0 + b.abs()))
    };
    let same = x.plus(&V::Tangent::zeros());
    if !near(same.minus(x), V::Tangent::zeros()) {
        return Err(format!("x + 0 is {same:?}, not x = {x:?}"));
    }
    let back = x.plus(&y.minus(x));
    if !near(back.minus(y), V::Tangent::zeros()) {
        return Err(format!("x + (y - x) is {back:?}, not y = {y:?}"));
    }
    let again = x.plus(delta).minus(x);
    if !near(again, *delta) {
        return Err(format!("(x + d) - x is {again:?}, not d = {delta:?}"));
    }
    Ok(())
}

/// Checks a camera at a point well inside its field of view: projections with and without Jacobian
/// agree, both Jacobians are correct, and unprojection inverts projection.
///
/// # Errors
/// A message with the violated invariant.
pub fn camera_laws(intrinsics: &Intrinsics, point_in_cam: &Vector3<f64>) -> Result<(), String> {
    with_camera_model!(intrinsics, M, params => camera_model_laws::<M>(params, point_in_cam))
}

fn camera_model_laws<M: CameraModel>(
    params: &M::Params,
    point_in_cam: &Vector3<f64>,
) -> Result<(), String> {
    let context = || format!("{} {:?} at {point_in_cam:?}", M::NAME, params.as_slice());
    let pixel = M::project(params, point_in_cam)
        .ok_or_else(|| format!("{}: does not project", context()))?;
    let projection = M::project_with_jacobian(params, point_in_cam)
        .ok_or_else(|| format!("{}: does not project with Jacobian", context()))?;
    if (pixel - projection.pixel).norm() > ROUND_TRIP_TOLERANCE * (1.0 + pixel.norm()) {
        return Err(format!(
            "{}: {pixel:?} without Jacobian, {:?} with",
            context(),
            projection.pixel
        ));
    }
    // The step is proportional to the distance of the point. Pixel coordinates are in the
    // thousands, so long steps reduce the effect of their rounding.
    jacobian_law(point_in_cam, &projection.d_point, STEP * point_in_cam.norm(), |p| {
        M::project(params, p)
    })
    .map_err(|error| format!("{}: point: {error}", context()))?;
    jacobian_law(params, &projection.d_params, STEP, |p| M::project(p, point_in_cam))
        .map_err(|error| format!("{}: parameters: {error}", context()))?;

    let ray = M::unproject(params, &pixel)
        .ok_or_else(|| format!("{}: {pixel:?} has no ray", context()))?;
    if (ray.norm() - 1.0).abs() > ROUND_TRIP_TOLERANCE {
        return Err(format!("{}: ray of norm {}", context(), ray.norm()));
    }
    let same = (ray - point_in_cam.normalize()).norm() <= ROUND_TRIP_TOLERANCE;
    if !same {
        return Err(format!("{}: unprojects to ray {ray:?}", context()));
    }
    Ok(())
}

/// Checks the invariants of [`Loss`] and its derivatives at a squared norm `s` > 0 away from a kink
/// of the loss.
///
/// # Errors
/// A message with the violated invariant.
pub fn loss_laws(loss: &Loss, s: f64) -> Result<(), String> {
    let [zero, slope, _] = loss.evaluate(0.0);
    if zero != 0.0 || slope != 1.0 {
        return Err(format!("{loss:?} starts at {zero} with slope {slope}"));
    }
    let [rho, d1, _] = loss.evaluate(s);
    if !(rho <= s && (0.0..=1.0).contains(&d1)) {
        return Err(format!("{loss:?} at {s}: rho {rho}, rho' {d1}"));
    }
    let at = |index: usize| move |s: &f64| Some(SVector::<f64, 1>::new(loss.evaluate(*s)[index]));
    for index in 0..2 {
        let analytic = SVector::<f64, 1>::new(loss.evaluate(s)[index + 1]);
        jacobian_law(&s, &analytic, STEP * s, at(index))
            .map_err(|error| format!("{loss:?}, derivative {}: {error}", index + 1))?;
    }
    Ok(())
}
