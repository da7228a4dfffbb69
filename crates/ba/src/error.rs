/// What can be wrong with a problem or with a question about it. A solve that ends without success is no error: see
/// [`Termination`](crate::Termination).
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A factor names a variable that the problem does not have.
    #[error(
        "{factor}: variable {position} has slot {slot}, but the problem holds {len} variables of that type"
    )]
    UnknownKey {
        /// The factor's type.
        factor: &'static str,
        /// Which of the factor's variables, from 0.
        position: usize,
        /// The slot it names.
        slot: u32,
        /// How many there are.
        len: usize,
    },
    /// A key that the problem does not have.
    #[error("slot {slot} of {variable} does not exist: the problem holds {len} of them")]
    UnknownVariable {
        /// The variable's type.
        variable: &'static str,
        /// The slot it names.
        slot: u32,
        /// How many there are.
        len: usize,
    },
    /// A factor names one variable twice.
    #[error("{factor}: variables {first} and {second} are the same")]
    RepeatedVariable {
        /// The factor's type.
        factor: &'static str,
        /// First position.
        first: usize,
        /// Second position.
        second: usize,
    },
    /// A factor joins two variables that were both declared as eliminated; the Schur complement needs them independent.
    #[error("{factor} number {index}: variables {first} and {second} are both declared eliminated")]
    TwoEliminated {
        /// The factor's type.
        factor: &'static str,
        /// Number of the factor among those of its type, from 0.
        index: usize,
        /// First position.
        first: usize,
        /// Second position.
        second: usize,
    },
    /// A tangent index outside the variable's dimension.
    #[error("tangent index {index} is out of range: {variable} has {dof} degrees of freedom")]
    TangentIndex {
        /// The variable's type.
        variable: &'static str,
        /// The index.
        index: usize,
        /// Degrees of freedom.
        dof: usize,
    },
    /// A residual or a Jacobian is not finite at the values the solve starts from.
    #[error("{factor} number {index}: {what} is {value} at the initial values")]
    NotFinite {
        /// The factor's type.
        factor: &'static str,
        /// Number of the factor among those of its type, from 0.
        index: usize,
        /// `residual` or `Jacobian`.
        what: &'static str,
        /// The first offending number.
        value: f64,
    },
    /// A standard deviation that is not a positive number.
    #[error("standard deviation {index} is {value}; it must be positive and finite")]
    Sigma {
        /// Which.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// The loss has a scale that is not a positive number.
    #[error("{factor}: the scale of {loss} must be positive and finite")]
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
        /// What is allowed.
        range: &'static str,
    },
    /// The problem got variables, factors or fixings after the solver was made from it.
    #[error("the problem has changed since its solver was made: make a new solver")]
    StructureChanged,
    /// A variable, or one that it depends on, is not determined by the factors: there is no finite covariance.
    #[error("the factors do not determine {variable} number {slot}, or what it depends on: fix the gauge")]
    Undetermined {
        /// The variable's type.
        variable: &'static str,
        /// Which of that type, from 0.
        slot: u32,
    },
    /// More factors or variables than 32-bit indices can number.
    #[error("{count} {what} are more than the {limit} that can be numbered")]
    TooLarge {
        /// What there are too many of.
        what: &'static str,
        /// How many.
        count: usize,
        /// The limit.
        limit: usize,
    },
}
