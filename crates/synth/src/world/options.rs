//! What a caller may choose of a street.

/// What stands along a street.
#[derive(Clone, Debug, PartialEq)]
pub struct StreetOptions {
    /// Share of the fronts that begin a terrace of equal houses.
    pub repeated_fraction: f64,
    /// Share of the house ends followed by a gap with a garden.
    pub gap_fraction: f64,
    /// Share of the parking bays that are taken.
    pub parked_fraction: f64,
    /// Share of the places for a tree that have one.
    pub tree_fraction: f64,
    /// Cars that drive, each a few car lengths to a hundred metres from the next.
    pub moving_cars: usize,
}

impl Default for StreetOptions {
    fn default() -> Self {
        Self {
            repeated_fraction: 0.2,
            gap_fraction: 0.35,
            parked_fraction: 0.45,
            tree_fraction: 0.6,
            moving_cars: 0,
        }
    }
}
