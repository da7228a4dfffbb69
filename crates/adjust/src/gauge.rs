use tiepoint_ba::{Key, Problem};
use tiepoint_geometry::Rigid3;
use tiepoint_scene::ImagePair;

use crate::Error;

/// What fixes the gauge of an adjustment: the position, orientation and scale of the world frame,
/// seven degrees of freedom that images alone leave open.
///
/// Constant poses ([`crate::AdjustOptions::constant_poses`], images outside a local scope) count as
/// held, and two of them fix the gauge. Constant rigs with a baseline fix the scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gauge {
    /// The pose of the first image is held, and one coordinate of the centre of the image farthest
    /// from it.
    #[default]
    FirstAndFarthest,
    /// The pose of the pair's first image is held, and one coordinate of the centre of its second.
    /// As [`Gauge::FirstAndFarthest`] where an image of the pair takes no part or a pose is
    /// constant.
    Pair(ImagePair),
    /// Nothing is held: terms determine the frame, such as measured positions. The model must be
    /// near their frame before the adjustment ([`crate::Term::frame`]). Steps along directions that
    /// no term determines are left to the damping of the optimiser; covariances are then singular.
    FixedByTerms,
}

/// Fixes the seven degrees of freedom of the gauge: position, orientation and scale of the world
/// frame.
///
/// Fixed are the pose of one camera and one coordinate of another camera's centre. The coordinate
/// is the one that changes most when the world is scaled about the first centre: a scaling by 1 + ε
/// moves a centre c by ε (c − c₁), which in its own frame is τ = −ε R (c − c₁). `poses` are
/// `cam_from_world`. The poses marked in `fixed` are constant already; two of them fix the gauge.
/// `pair` selects the two poses by their indices. By default they are the first pose and the one
/// farthest from it.
///
/// # Errors
///
/// If a pose is no variable of the problem.
pub fn fix_gauge(
    problem: &mut Problem,
    poses: &[Key<Rigid3>],
    fixed: &[bool],
    pair: Option<[usize; 2]>,
) -> Result<(), Error> {
    let num_fixed = fixed.iter().filter(|fixed| **fixed).count();
    if num_fixed >= 2 || poses.is_empty() {
        return Ok(());
    }
    let pair = pair.filter(|_| num_fixed == 0);
    let first = match pair {
        Some([first, _]) => first,
        None => fixed.iter().position(|fixed| *fixed).unwrap_or(0),
    };
    let first_centre = problem.get(poses[first]).origin_in_a();
    problem.fix(poses[first]);
    let direction = |key: Key<Rigid3>| {
        let pose = problem.get(key);
        (key, pose.rotation * (pose.origin_in_a() - first_centre))
    };
    let second = match pair {
        Some([_, second]) => Some(direction(poses[second])),
        None => poses
            .iter()
            .map(|key| direction(*key))
            .max_by(|a, b| a.1.norm_squared().total_cmp(&b.1.norm_squared())),
    };
    if let Some((key, direction)) = second {
        // The tangent of a pose is its rotation, then the motion of the centre in the camera frame.
        problem.fix_dofs(key, &[3 + direction.iamax()])?;
    }
    Ok(())
}
