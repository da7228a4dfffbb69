//! Places on the earth: geodetic coordinates of WGS 84, earth-centred ones, local frames, and UTM.
//!
//! ECEF is earth-centred and earth-fixed, in metres: x through the equator at longitude 0, z
//! through the north pole. A local frame is ENU: x east, y north, z up, in metres, tangential to
//! the ellipsoid at its origin. Heights are above the ellipsoid; who has heights above the sea gets
//! a frame that is higher or lower by the undulation of the geoid, at most 110 m.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

/// Semi-major axis of WGS 84, in metres (NGA.STND.0036).
const A_M: f64 = 6_378_137.0;
/// Flattening of WGS 84.
const F: f64 = 1.0 / 298.257_223_563;
/// Square of the first eccentricity.
const E2: f64 = F * (2.0 - F);

/// A place by geodetic latitude and longitude of WGS 84.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Geodetic {
    /// Latitude, north positive. Degrees, so that what files say comes back to the last digit.
    pub latitude_deg: f64,
    /// Longitude, east positive.
    pub longitude_deg: f64,
    /// Height above the ellipsoid, in metres.
    pub height_m: f64,
}

impl Geodetic {
    /// The place in ECEF.
    pub fn to_ecef(&self) -> Vector3<f64> {
        let (sin_lat, cos_lat) = self.latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude_deg.to_radians().sin_cos();
        let normal = radius_of_normal(sin_lat);
        Vector3::new(
            (normal + self.height_m) * cos_lat * cos_lon,
            (normal + self.height_m) * cos_lat * sin_lon,
            (normal * (1.0 - E2) + self.height_m) * sin_lat,
        )
    }

    /// Of a place in ECEF, by the iteration of Bowring (1976) on the parametric latitude. From
    /// 6000 km below the surface on, where the direction of up is not unique, it is no inverse.
    pub fn from_ecef(ecef: &Vector3<f64>) -> Self {
        let axis = ecef.x.hypot(ecef.y);
        let b = A_M * (1.0 - F);
        let of_parametric = |sin: f64, cos: f64| {
            (ecef.z + E2 / (1.0 - E2) * b * sin.powi(3)).atan2(axis - E2 * A_M * cos.powi(3))
        };
        let mut latitude_rad = (ecef.z).atan2(axis * (1.0 - E2));
        // Each step gains five digits near the surface, and two at the distance of the moon.
        for _ in 0..6 {
            let (sin, cos) = latitude_rad.sin_cos();
            let (sin, cos) = ((1.0 - F) * sin, cos);
            let norm = sin.hypot(cos);
            latitude_rad = of_parametric(sin / norm, cos / norm);
        }
        let (sin, cos) = latitude_rad.sin_cos();
        // The distance along the normal, which is stable at the poles, too.
        let height_m = axis * cos + ecef.z * sin - A_M * (1.0 - E2 * sin * sin).sqrt();
        let longitude_deg = ecef.y.atan2(ecef.x).to_degrees();
        Self { latitude_deg: latitude_rad.to_degrees(), longitude_deg, height_m }
    }
}

/// Radius of curvature across the meridian.
fn radius_of_normal(sin_latitude: f64) -> f64 {
    A_M / (1.0 - E2 * sin_latitude * sin_latitude).sqrt()
}

/// An ENU frame. At a pole, north is that of the meridian of its longitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    origin: Geodetic,
    origin_ecef: Vector3<f64>,
    enu_from_ecef: Matrix3<f64>,
}

impl LocalFrame {
    /// The frame with this origin.
    pub fn new(origin: Geodetic) -> Self {
        let (sin_lat, cos_lat) = origin.latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = origin.longitude_deg.to_radians().sin_cos();
        #[rustfmt::skip]
        let enu_from_ecef = Matrix3::new(
            -sin_lon, cos_lon, 0.0,
            -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat,
            cos_lat * cos_lon, cos_lat * sin_lon, sin_lat,
        );
        Self { origin, origin_ecef: origin.to_ecef(), enu_from_ecef }
    }

    /// The origin.
    pub fn origin(&self) -> &Geodetic {
        &self.origin
    }

    /// Local coordinates of a place.
    pub fn to_local(&self, place: &Geodetic) -> Vector3<f64> {
        self.enu_from_ecef * (place.to_ecef() - self.origin_ecef)
    }

    /// The place of local coordinates.
    pub fn to_geodetic(&self, local: &Vector3<f64>) -> Geodetic {
        Geodetic::from_ecef(&(self.origin_ecef + self.enu_from_ecef.tr_mul(local)))
    }
}

/// The scale of UTM on its central meridian, and its false easting and, in the south, northing.
const UTM_SCALE: f64 = 0.9996;
const FALSE_EASTING_M: f64 = 500_000.0;
const FALSE_NORTHING_M: f64 = 10_000_000.0;

/// A zone of the Universal Transverse Mercator projection of WGS 84.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UtmZone {
    /// 1 to 60.
    pub number: u8,
    /// Whether northings are from the equator; else they have 10 000 km added.
    pub is_north: bool,
}

impl UtmZone {
    /// Of an EPSG code, 32601 to 32660 (north) and 32701 to 32760 (south).
    pub fn from_epsg(code: u32) -> Option<Self> {
        let is_north = match code / 100 {
            326 => true,
            327 => false,
            _ => return None,
        };
        let number = (code % 100) as u8;
        (1..=60).contains(&number).then_some(Self { number, is_north })
    }

    /// Width of a zone, in degrees of longitude.
    pub const WIDTH_DEG: f64 = 6.0;

    /// The zone that a place is in, by its longitude: without the exceptions of Norway and
    /// Svalbard.
    pub fn of(place: &Geodetic) -> Self {
        let from_west_deg = (place.longitude_deg + 180.0).rem_euclid(360.0);
        let number = 1 + (from_west_deg / Self::WIDTH_DEG) as u8;
        Self { number: number.clamp(1, 60), is_north: place.latitude_deg >= 0.0 }
    }

    /// The longitude of its middle.
    pub fn central_meridian_deg(self) -> f64 {
        Self::WIDTH_DEG * f64::from(self.number) - 183.0
    }

    fn central_meridian_rad(self) -> f64 {
        self.central_meridian_deg().to_radians()
    }

    /// Easting and northing of a place, in metres, and its height: the series of Krüger (1912) to
    /// the fourth order (Karney 2011, Eqs. 7 to 11 and 35), with errors below a micrometre in and
    /// beside the zone.
    pub fn project(self, place: &Geodetic) -> Vector3<f64> {
        let longitude = place.longitude_deg.to_radians() - self.central_meridian_rad();
        let (sin, e) = (place.latitude_deg.to_radians().sin(), E2.sqrt());
        let conformal = (sin.atanh() - e * (e * sin).atanh()).sinh();
        let xi = conformal.atan2(longitude.cos());
        let eta = (longitude.sin() / conformal.hypot(longitude.cos())).asinh();
        let ([alpha, _], radius) = kruger();
        let (mut x, mut y) = (eta, xi);
        for (j, alpha) in (1..).map(|j| 2.0 * f64::from(j)).zip(alpha) {
            y += alpha * (j * xi).sin() * (j * eta).cosh();
            x += alpha * (j * xi).cos() * (j * eta).sinh();
        }
        let north_m = if self.is_north { 0.0 } else { FALSE_NORTHING_M };
        let [x, y] = [x, y].map(|value| UTM_SCALE * radius * value);
        Vector3::new(FALSE_EASTING_M + x, north_m + y, place.height_m)
    }

    /// The place of easting, northing and height.
    pub fn unproject(self, projected: &Vector3<f64>) -> Geodetic {
        let north_m = if self.is_north { 0.0 } else { FALSE_NORTHING_M };
        let ([_, beta], radius) = kruger();
        let eta = (projected.x - FALSE_EASTING_M) / (UTM_SCALE * radius);
        let xi = (projected.y - north_m) / (UTM_SCALE * radius);
        let (mut x, mut y) = (eta, xi);
        for (j, beta) in (1..).map(|j| 2.0 * f64::from(j)).zip(beta) {
            y -= beta * (j * xi).sin() * (j * eta).cosh();
            x -= beta * (j * xi).cos() * (j * eta).sinh();
        }
        let e = E2.sqrt();
        let isometric = (y.sin() / x.cosh()).atanh();
        let mut sin = isometric.tanh();
        // Each step gains two digits.
        for _ in 0..9 {
            sin = (isometric + e * (e * sin).atanh()).tanh();
        }
        let longitude = self.central_meridian_rad() + x.sinh().atan2(y.cos());
        // The zones at the date line reach across it.
        let turns = (longitude / TAU).round();
        Geodetic {
            latitude_deg: sin.asin().to_degrees(),
            longitude_deg: longitude.to_degrees() - 360.0 * turns,
            height_m: projected.z,
        }
    }
}

/// Coefficients of the series for the projection and its inverse, and the radius of the rectifying
/// sphere.
fn kruger() -> ([[f64; 4]; 2], f64) {
    let n = F / (2.0 - F);
    let [n2, n3, n4] = [n.powi(2), n.powi(3), n.powi(4)];
    let alpha = [
        n / 2.0 - 2.0 / 3.0 * n2 + 5.0 / 16.0 * n3 + 41.0 / 180.0 * n4,
        13.0 / 48.0 * n2 - 3.0 / 5.0 * n3 + 557.0 / 1440.0 * n4,
        61.0 / 240.0 * n3 - 103.0 / 140.0 * n4,
        49561.0 / 161280.0 * n4,
    ];
    let beta = [
        n / 2.0 - 2.0 / 3.0 * n2 + 37.0 / 96.0 * n3 - n4 / 360.0,
        n2 / 48.0 + n3 / 15.0 - 437.0 / 1440.0 * n4,
        17.0 / 480.0 * n3 - 37.0 / 840.0 * n4,
        4397.0 / 161280.0 * n4,
    ];
    ([alpha, beta], A_M / (1.0 + n) * (1.0 + n2 / 4.0 + n4 / 64.0))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Printed digits of PROJ's values.
    const PROJ_M: f64 = 1e-8;
    /// What [`UtmZone`] states of its series, there and back. PROJ's values are printed to a
    /// micrometre, and its own series of the sixth order is exact to nanometres.
    const SERIES_M: f64 = 1e-6;
    /// Rounding of coordinates of the size of the earth: 6.4e6 m · 2⁻⁵², a few operations.
    const ROUNDING_M: f64 = 1e-8;

    /// Values of PROJ 9 (pyproj 3.7): EPSG:4979 to EPSG:4978.
    #[test]
    fn ecef_is_that_of_proj() {
        for ([latitude_deg, longitude_deg, height_m], ecef) in [
            ([0.0, 0.0, 0.0], [6378137.0, 0.0, 0.0]),
            ([48.1374, 11.5755, 519.0], [4177959.247494289, 855750.235971749, 4727472.030086931]),
            (
                [-33.8568, 151.2153, -20.5],
                [-4646953.717043525, 2553068.722852104, -3533255.706547966],
            ),
            ([89.9999, -45.0, 8848.0], [7.908876656, -7.908876656, 6365600.314235418]),
            ([-90.0, 0.0, 100.0], [0.0, 0.0, -6356852.314245179]),
            ([55.7047, 13.191, 400000.0], [3726447.950825234, 873412.948126252, 5576444.488578971]),
        ] {
            let place = Geodetic { latitude_deg, longitude_deg, height_m };
            let found = place.to_ecef();
            assert!((found - Vector3::from(ecef)).norm() < PROJ_M, "{found}");
            let back = Geodetic::from_ecef(&found);
            assert!((back.to_ecef() - found).norm() < ROUNDING_M, "{back:?}");
        }
    }

    /// Values of PROJ's `topocentric`.
    #[test]
    fn local_coordinates_are_those_of_proj() {
        let place = |[latitude_deg, longitude_deg, height_m]: [f64; 3]| Geodetic {
            latitude_deg,
            longitude_deg,
            height_m,
        };
        let frame = LocalFrame::new(place([48.1374, 11.5755, 519.0]));
        for (geodetic, enu) in [
            ([48.1374, 11.5755, 519.0], [0.0, 0.0, 0.0]),
            ([48.1474, 11.5855, 530.0], [744.186998628, 1112.071781743, 10.859618423]),
            ([48.0, 11.0, 0.0], [-42946.168831382, -15117.088135536, -681.255470237]),
        ] {
            let found = frame.to_local(&place(geodetic));
            assert!((found - Vector3::from(enu)).norm() < PROJ_M, "{found}");
        }
    }

    #[test]
    fn utm_is_that_of_proj() {
        for (code, [latitude_deg, longitude_deg], projected) in [
            (32632, [48.1374, 11.5755], [691603.031991, 5334780.030903]),
            (32756, [-33.8568, 151.2153], [334900.569652, 6252288.752888]),
            (32633, [55.698, 13.195], [386556.667098, 6173944.966205]),
            (32631, [0.0, 0.0], [166021.443081, 0.0]),
            (32660, [70.0, -179.0], [652590.036385, 7770880.822430]),
        ] {
            let zone = UtmZone::from_epsg(code).unwrap();
            let place = Geodetic { latitude_deg, longitude_deg, height_m: 7.0 };
            let found = zone.project(&place);
            let expected = Vector3::new(projected[0], projected[1], 7.0);
            assert!((found - expected).norm() < SERIES_M, "{code}: {found}");
            let back = zone.unproject(&found).to_ecef() - place.to_ecef();
            assert!(back.norm() < SERIES_M, "{code}: {back}");
            let turned_deg = zone.unproject(&found).longitude_deg - longitude_deg;
            assert!(turned_deg.abs() < 1.0, "{code}: from -180 to 180 across the date line, too");
            // 11.5755° and 13.195° are in zones 32 and 33, -179° in zone 1.
            let is_beside = code == 32660;
            assert_eq!(UtmZone::of(&place) == zone, !is_beside, "{code}");
        }
        for code in [4326, 32600, 32661, 32700, 32761] {
            assert_eq!(UtmZone::from_epsg(code), None);
        }
    }

    proptest! {
        /// Also across the date line and near the poles.
        #[test]
        fn local_coordinates_come_back(
            latitude_deg in -90.0..=90.0_f64,
            longitude_deg in -180.0..=180.0_f64,
            height_m in -1e4..1e6_f64,
            local in prop::array::uniform3(-1e5..1e5_f64),
        ) {
            let frame = LocalFrame::new(Geodetic { latitude_deg, longitude_deg, height_m });
            let local = Vector3::from(local);
            let place = frame.to_geodetic(&local);
            prop_assert!((frame.to_local(&place) - local).norm() < ROUNDING_M);
            // The axes are east, north and up.
            let up = frame.to_local(&Geodetic { height_m: height_m + 1.0, ..*frame.origin() });
            prop_assert!((up - Vector3::z()).norm() < ROUNDING_M);
        }
    }
}
