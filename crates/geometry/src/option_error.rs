/// An option that is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("option {name} = {value} is out of range: {range}")]
pub struct OptionError {
    /// The option's name.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// The allowed range.
    pub range: &'static str,
}

impl OptionError {
    /// Checks that a value `is_valid`.
    ///
    /// # Errors
    ///
    /// The error of this value if it is not.
    pub fn check(
        name: &'static str,
        value: f64,
        is_valid: bool,
        range: &'static str,
    ) -> Result<(), Self> {
        if is_valid { Ok(()) } else { Err(Self { name, value, range }) }
    }

    /// Checks that a value is finite and above 0.
    ///
    /// # Errors
    ///
    /// The error of this value if it is not.
    pub fn check_positive(name: &'static str, value: f64) -> Result<(), Self> {
        Self::check(name, value, value.is_finite() && value > 0.0, "finite and above 0")
    }

    /// Checks that a value is between 0 and 1, both included.
    ///
    /// # Errors
    ///
    /// The error of this value if it is not.
    pub fn check_ratio(name: &'static str, value: f64) -> Result<(), Self> {
        Self::check(name, value, (0.0..=1.0).contains(&value), "0 to 1")
    }

    /// Checks that an angle is between 0 and π, both included, in radians.
    ///
    /// # Errors
    ///
    /// The error of this value if it is not.
    pub fn check_angle(name: &'static str, value: f64) -> Result<(), Self> {
        let is_valid = (0.0..=std::f64::consts::PI).contains(&value);
        Self::check(name, value, is_valid, "0 to π, in radians")
    }
}
