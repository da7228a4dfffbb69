//! Coordinate reference systems as well-known text (OGC 01-009), as LAS 1.4 wants it. The texts
//! are those of GDAL and PROJ.

use tiepoint_geometry::crs::Crs;
use tiepoint_geometry::geodesy::UtmZone;

fn node(keyword: &str, parts: &[String]) -> String {
    format!("{keyword}[{}]", parts.join(","))
}

fn quoted(text: &str) -> String {
    format!("\"{text}\"")
}

fn authority(code: u32) -> String {
    format!("AUTHORITY[\"EPSG\",\"{code}\"]")
}

fn unit(name: &str, size: &str, code: u32) -> String {
    node("UNIT", &[quoted(name), size.to_owned(), authority(code)])
}

fn metre() -> String {
    unit("metre", "1", 9001)
}

fn axis(name: &str, direction: &str) -> String {
    node("AXIS", &[quoted(name), direction.to_owned()])
}

fn parameter(name: &str, value: impl ToString) -> String {
    node("PARAMETER", &[quoted(name), value.to_string()])
}

/// Datum and prime meridian.
fn datum(is_etrs89: bool) -> String {
    let (name, code) = match is_etrs89 {
        true => ("European_Terrestrial_Reference_System_1989", 6258),
        false => ("WGS_1984", 6326),
    };
    let (ellipsoid, inverse_flattening, ellipsoid_code) = match is_etrs89 {
        true => ("GRS 1980", "298.257222101", 7019),
        false => ("WGS 84", "298.257223563", 7030),
    };
    let semi_major_m = "6378137".to_owned();
    let ellipsoid = node(
        "SPHEROID",
        &[
            quoted(ellipsoid),
            semi_major_m,
            inverse_flattening.to_owned(),
            authority(ellipsoid_code),
        ],
    );
    let greenwich = node("PRIMEM", &[quoted("Greenwich"), "0".to_owned(), authority(8901)]);
    node("DATUM", &[quoted(name), ellipsoid, authority(code)]) + "," + &greenwich
}

/// Name and text of the system of longitude and latitude.
fn geographic(is_etrs89: bool) -> (&'static str, String) {
    let (name, code) = if is_etrs89 { ("ETRS89", 4258) } else { ("WGS 84", 4326) };
    let degree = unit("degree", "0.0174532925199433", 9122);
    (name, node("GEOGCS", &[quoted(name), datum(is_etrs89), degree, authority(code)]))
}

/// The text of a system, with the height above the ellipsoid if that is known. The text has no
/// coordinates of three dimensions; GDAL writes and reads heights as a second system beside the
/// first, and PROJ makes one of both.
pub(super) fn wkt(crs: Crs, has_heights: bool) -> String {
    let (name, horizontal) = match crs {
        Crs::Geocentric => {
            let axes = [("Geocentric X", "OTHER"), ("Geocentric Y", "OTHER")];
            let [x, y] = axes.map(|(name, direction)| axis(name, direction));
            let z = axis("Geocentric Z", "NORTH");
            let code = authority(crs.epsg());
            return node("GEOCCS", &[quoted("WGS 84"), datum(false), metre(), x, y, z, code]);
        }
        Crs::Geographic { .. } => {
            let (name, text) = geographic(false);
            (name.to_owned(), text)
        }
        Crs::Utm { zone, is_etrs89 } => {
            let (of_datum, geographic) = geographic(is_etrs89);
            let UtmZone { number, is_north } = zone;
            let name =
                format!("{of_datum} / UTM zone {number}{}", if is_north { "N" } else { "S" });
            let parts = [
                quoted(&name),
                geographic,
                node("PROJECTION", &[quoted("Transverse_Mercator")]),
                parameter("latitude_of_origin", 0),
                parameter("central_meridian", zone.central_meridian_deg()),
                parameter("scale_factor", 0.9996),
                parameter("false_easting", 500_000),
                parameter("false_northing", if is_north { 0 } else { 10_000_000 }),
                metre(),
                axis("Easting", "EAST"),
                axis("Northing", "NORTH"),
                authority(crs.epsg()),
            ];
            (name, node("PROJCS", &parts))
        }
    };
    if !has_heights {
        return horizontal;
    }
    // 2002: heights above the ellipsoid.
    let datum = node("VERT_DATUM", &[quoted("Ellipsoid"), "2002".to_owned()]);
    let up = axis("Ellipsoidal height", "UP");
    let vertical = node("VERT_CS", &[quoted("Ellipsoid"), datum, metre(), up]);
    node("COMPD_CS", &[quoted(&format!("{name} + Ellipsoid")), horizontal, vertical])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `CRS.from_epsg(code).to_wkt("WKT1_GDAL")` of pyproj 3.7.2 with PROJ 9.5.1.
    #[rustfmt::skip]
    const PROJ: [(u32, &[&str]); 5] = [
        (4326, &[
            r#"GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,"#,
            r#"298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],"#,
            r#"PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],UNIT["degree","#,
            r#"0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]]"#,
        ]),
        (4978, &[
            r#"GEOCCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,"#,
            r#"298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],"#,
            r#"PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],UNIT["metre",1,"#,
            r#"AUTHORITY["EPSG","9001"]],AXIS["Geocentric X",OTHER],"#,
            r#"AXIS["Geocentric Y",OTHER],AXIS["Geocentric Z",NORTH],AUTHORITY["EPSG","#,
            r#""4978"]]"#,
        ]),
        (32632, &[
            r#"PROJCS["WGS 84 / UTM zone 32N",GEOGCS["WGS 84",DATUM["WGS_1984","#,
            r#"SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],"#,
            r#"AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","#,
            r#""8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],"#,
            r#"AUTHORITY["EPSG","4326"]],PROJECTION["Transverse_Mercator"],"#,
            r#"PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",9],"#,
            r#"PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],"#,
            r#"PARAMETER["false_northing",0],UNIT["metre",1,AUTHORITY["EPSG","9001"]],"#,
            r#"AXIS["Easting",EAST],AXIS["Northing",NORTH],AUTHORITY["EPSG","32632"]]"#,
        ]),
        (32756, &[
            r#"PROJCS["WGS 84 / UTM zone 56S",GEOGCS["WGS 84",DATUM["WGS_1984","#,
            r#"SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],"#,
            r#"AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","#,
            r#""8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],"#,
            r#"AUTHORITY["EPSG","4326"]],PROJECTION["Transverse_Mercator"],"#,
            r#"PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",153],"#,
            r#"PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],"#,
            r#"PARAMETER["false_northing",10000000],UNIT["metre",1,AUTHORITY["EPSG","#,
            r#""9001"]],AXIS["Easting",EAST],AXIS["Northing",NORTH],AUTHORITY["EPSG","#,
            r#""32756"]]"#,
        ]),
        (25832, &[
            r#"PROJCS["ETRS89 / UTM zone 32N",GEOGCS["ETRS89","#,
            r#"DATUM["European_Terrestrial_Reference_System_1989",SPHEROID["GRS 1980","#,
            r#"6378137,298.257222101,AUTHORITY["EPSG","7019"]],AUTHORITY["EPSG","#,
            r#""6258"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],UNIT["degree","#,
            r#"0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4258"]],"#,
            r#"PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],"#,
            r#"PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],"#,
            r#"PARAMETER["false_easting",500000],PARAMETER["false_northing",0],"#,
            r#"UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],"#,
            r#"AXIS["Northing",NORTH],AUTHORITY["EPSG","25832"]]"#,
        ]),
    ];

    #[test]
    fn texts_are_those_of_proj() {
        for (code, parts) in PROJ {
            assert_eq!(wkt(Crs::from_epsg(code).unwrap(), false), parts.concat());
        }
    }

    /// pyproj 3.7.2 reads these as `to_2d().to_epsg()` = code and three axes, the last one up.
    #[test]
    fn heights_are_a_system_beside() {
        let crs = Crs::from_epsg(32632).unwrap();
        let heights = concat!(
            ",VERT_CS[\"Ellipsoid\",VERT_DATUM[\"Ellipsoid\",2002],UNIT[\"metre\",1,",
            "AUTHORITY[\"EPSG\",\"9001\"]],AXIS[\"Ellipsoidal height\",UP]]]"
        );
        let horizontal = wkt(crs, false);
        let name = "COMPD_CS[\"WGS 84 / UTM zone 32N + Ellipsoid\",";
        assert_eq!(wkt(crs, true), format!("{name}{horizontal}{heights}"));
        let ecef = Crs::from_epsg(4978).unwrap();
        assert_eq!(wkt(ecef, true), wkt(ecef, false));
    }
}
