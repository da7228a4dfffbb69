use tiepoint_ba::{Key, Problem};
use tiepoint_geometry::Rigid3;

use crate::Error;

/// Holds what no pixel depends on: place, orientation and size of the world.
///
/// These are the pose of one camera and, of another, the one coordinate in which its centre moves
/// most when the world is scaled about the first: scaling by 1 + ε moves a centre c by ε (c − c₁),
/// which in its own frame is τ = −ε R (c − c₁). `poses` are `cam_from_world`; those of `fixed` are
/// held already, and with two of them there is nothing left to hold. `pair` asks for the two poses
/// to hold, by their indices; by default they are the first and the one farthest from it.
///
/// # Errors
///
/// Where a pose is no variable of the problem.
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
        // The tangent of a pose is its rotation, then how its centre moves in its frame.
        problem.fix_dofs(key, &[3 + direction.iamax()])?;
    }
    Ok(())
}
