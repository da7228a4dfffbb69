//! Laws that every manifold, camera model, loss and Jacobian obeys, as plain functions of values:
//! `Err` says what is broken. Tests feed them with random values; a new type costs one line there.

mod solver_laws;

use nalgebra::{SVector, Vector3};

use crate::{Block, CameraModel, Intrinsics, Loss, Manifold};
pub use solver_laws::{SolverProblem, SolverTrial, solver_problem};

/// Step of numeric differentiation in the tangent space, relative to the size of the value; with
/// the five-point rule the error is h⁴ of the fifth derivative plus ε/h: about 1e-12 for functions
/// of unit size.
const STEP: f64 = 1e-3;

/// Accepted difference of analytic and numeric derivatives, relative to the largest entry of the
/// column.
const DERIVATIVE_TOLERANCE: f64 = 1e-7;

/// Accepted rounding error of a round trip, relative to numbers of unit size.
const ROUND_TRIP_TOLERANCE: f64 = 1e-9;

/// d residual / d x at `x`, by the five-point rule with `step` in every tangent direction. `None`
/// where the residual is undefined nearby.
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

/// The analytic Jacobian is the derivative of `residual` with respect to `plus` at zero. Where the
/// residual is undefined nearby, there is nothing to check.
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

/// Laws of a manifold at `x` and `y`, and for a tangent vector `delta` that is shorter than the
/// injectivity radius.
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

/// Laws of a camera for a point that lies well inside what its lens sees.
pub fn camera_laws(intrinsics: &Intrinsics, point_in_cam: &Vector3<f64>) -> Result<(), String> {
    with_camera_model!(intrinsics, M, params => camera_model_laws::<M>(params, point_in_cam))
}

fn camera_model_laws<M: CameraModel>(
    params: &M::Params,
    point_in_cam: &Vector3<f64>,
) -> Result<(), String> {
    let context = || format!("{} {:?} at {point_in_cam:?}", M::NAME, params.as_slice());
    let pixel =
        M::project(params, point_in_cam).ok_or_else(|| format!("{}: not seen", context()))?;
    let projection = M::project_with_jacobian(params, point_in_cam)
        .ok_or_else(|| format!("{}: not seen with Jacobian", context()))?;
    if (pixel - projection.pixel).norm() > ROUND_TRIP_TOLERANCE * (1.0 + pixel.norm()) {
        return Err(format!(
            "{}: {pixel:?} without Jacobian, {:?} with",
            context(),
            projection.pixel
        ));
    }
    // Steps in proportion to the depth; pixels are thousands of units, so that their rounding is
    // felt less with long steps.
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
        return Err(format!("{}: comes back as ray {ray:?}", context()));
    }
    Ok(())
}

/// Laws of a loss at a squared norm `s` > 0 that lies away from a kink of the loss.
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
