/// Invalid problems and requests. A solve that ends without convergence is not an error, see
/// [`Termination`](crate::Termination).
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A factor names a variable that the problem does not have.
    #[error(
        "{kind}: variable {position} has slot {slot}, but the problem holds {len} variables of \
        that type", kind = words(factor))]
    UnknownKey {
        /// The factor's type.
        factor: &'static str,
        /// Position among the factor's variables, from 0.
        position: usize,
        /// The slot in the key.
        slot: u32,
        /// Number of variables of that type.
        len: usize,
    },
    /// A key of a variable that the problem does not have.
    #[error("slot {slot} of {kind} does not exist: the problem holds {len} of \
    them", kind = words(variable))]
    UnknownVariable {
        /// The variable's type.
        variable: &'static str,
        /// The slot in the key.
        slot: u32,
        /// Number of variables of that type.
        len: usize,
    },
    /// A factor names one variable twice.
    #[error("{kind}: variables {first} and {second} are the same", kind = words(factor))]
    RepeatedVariable {
        /// The factor's type.
        factor: &'static str,
        /// First position.
        first: usize,
        /// Second position.
        second: usize,
    },
    /// A factor joins two eliminated variables; the Schur complement needs them to be independent.
    #[error("{kind} number {index}: variables {first} and {second} are both declared \
    eliminated", kind = words(factor))]
    TwoEliminated {
        /// The factor's type.
        factor: &'static str,
        /// Index of the factor among those of its type, from 0.
        index: usize,
        /// First position.
        first: usize,
        /// Second position.
        second: usize,
    },
    /// A tangent index outside the variable's dimension.
    #[error("tangent index {index} is out of range: {kind} has {dof} degrees of \
    freedom", kind = words(variable))]
    TangentIndex {
        /// The variable's type.
        variable: &'static str,
        /// The index.
        index: usize,
        /// Degrees of freedom.
        dof: usize,
    },
    /// A residual or a Jacobian is not finite at the initial values.
    #[error("{kind} number {index}: {what} is {value:e} at the initial \
    values", kind = words(factor))]
    NotFinite {
        /// The factor's type.
        factor: &'static str,
        /// Index of the factor among those of its type, from 0.
        index: usize,
        /// The quantity: `residual`, `squared residual`, `Jacobian` or `sum of squares`.
        what: &'static str,
        /// Its first value that is not finite.
        value: f64,
    },
    /// A standard deviation that is not a positive number.
    #[error("standard deviation {index} is {value}; it must be positive and finite")]
    Sigma {
        /// Index of the standard deviation.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// The loss has a scale that is not a positive number.
    #[error("{kind}: the scale of {loss} must be positive and finite", kind = words(factor))]
    LossScale {
        /// The factor's type.
        factor: &'static str,
        /// The loss.
        loss: String,
    },
    /// An option is out of range.
    #[error("option {name} = {value} is out of range: {range}")]
    Option {
        /// The option's name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The allowed range.
        range: &'static str,
    },
    /// Variables, factors or fixed directions have changed since the solver was made.
    #[error("the problem has changed since its solver was made: make a new solver")]
    StructureChanged,
    /// The factors do not determine a variable, or one that it depends on: its covariance is
    /// infinite.
    #[error("the factors do not determine {kind} number {slot}, or what it depends on: fix the \
    gauge", kind = words(variable))]
    Undetermined {
        /// The variable's type.
        variable: &'static str,
        /// Index among the variables of that type, from 0.
        slot: u32,
    },
    /// More factors or variables than 32-bit indices can number.
    #[error("{count} {what} are more than the {limit} that can be numbered")]
    TooLarge {
        /// The items.
        what: &'static str,
        /// Their number.
        count: usize,
        /// The limit.
        limit: usize,
    },
}

/// Type name in words, without path and parameters: `a::b::RollingShutter<c::D>` is a rolling
/// shutter.
fn words(type_name: &str) -> String {
    let name = type_name.split('<').next().unwrap_or_default();
    let name = name.rsplit("::").next().unwrap_or_default();
    let mut words = String::new();
    for (index, c) in name.char_indices() {
        if c.is_uppercase() && index > 0 {
            words.push(' ');
        }
        words.extend(c.to_lowercase());
    }
    words
}

#[cfg(test)]
mod tests {
    use super::Error;

    #[test]
    fn messages_have_words_and_no_types() {
        let factor =
            "tiepoint_ba::factors::reprojection::RollingReprojection<tiepoint_geometry::Radial>";
        let error = Error::NotFinite { factor, index: 7, what: "residual", value: f64::INFINITY };
        assert_eq!(
            error.to_string(),
            "rolling reprojection number 7: residual is inf at the initial values"
        );
        let error = Error::TangentIndex { variable: "nalgebra::Vector3<f64>", index: 4, dof: 3 };
        assert_eq!(
            error.to_string(),
            "tangent index 4 is out of range: vector3 has 3 degrees of freedom"
        );
    }
}
