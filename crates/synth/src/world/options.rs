//! Options of a street.

/// Options of a street.
#[derive(Clone, Debug, PartialEq)]
pub struct StreetOptions {
    /// Fraction of the house fronts that begin a terrace of equal houses.
    pub repeated_fraction: f64,
    /// Fraction of the ends of houses and terraces that a gap with a garden follows.
    pub gap_fraction: f64,
    /// Fraction of occupied parking bays.
    pub parked_fraction: f64,
    /// Fraction of the sites of trees with a tree.
    pub tree_fraction: f64,
    /// Number of moving cars, at distances of 12 m to 70 m from each other.
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
