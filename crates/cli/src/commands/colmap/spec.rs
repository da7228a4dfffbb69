//! Description of an option: type of its values, effect, default.

/// The values that an option takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Bool,
    Int,
    Real,
    Text,
    Path,
}

/// Effect of an option.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    /// It has the same effect as in COLMAP.
    Used,
    /// It concerns speed or logs. The results do not depend on it.
    Speed,
    /// It tunes a method that this program does not have. A warning says so.
    Tuning,
    /// Only its default value is accepted: this program has no results for another value.
    Fixed,
}

/// An option.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spec {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    /// COLMAP's default; empty if there is none.
    pub(super) default: &'static str,
    pub(super) effect: Effect,
}

impl Kind {
    /// The value in its plain form, booleans as 0 and 1; `None` if it is not of this kind.
    pub(super) fn checked(self, value: &str) -> Option<String> {
        match self {
            Self::Bool => match value.to_ascii_lowercase().as_str() {
                "1" | "true" | "yes" | "on" => Some("1".to_owned()),
                "0" | "false" | "no" | "off" => Some("0".to_owned()),
                _ => None,
            },
            Self::Int => value.parse::<i64>().ok().map(|number| number.to_string()),
            Self::Real => {
                let number: f64 = value.parse().ok()?;
                number.is_finite().then(|| value.to_owned())
            }
            Self::Text | Self::Path => Some(value.to_owned()),
        }
    }

    pub(super) fn is_same(self, value: &str, default: &str) -> bool {
        match (self, value.parse::<f64>(), default.parse::<f64>()) {
            (Self::Real, Ok(value), Ok(default)) => value == default,
            _ => value.eq_ignore_ascii_case(default),
        }
    }

    pub(super) fn described(self) -> &'static str {
        match self {
            Self::Bool => "0 or 1",
            Self::Int => "a whole number",
            Self::Real => "a number",
            Self::Text => "a text",
            Self::Path => "a path",
        }
    }
}
