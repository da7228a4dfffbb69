//! Effects that make a drive realistic. Each can be switched on separately.

use std::str::FromStr;

use crate::Error;
use crate::error::require;

/// Differences between the clocks and triggers of the cameras. Values are upper bounds; each camera
/// but the first draws its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockEffects {
    /// Largest absolute clock offset, in seconds.
    pub offset_s: f64,
    /// Largest absolute clock drift, in parts per million.
    pub drift_ppm: f64,
    /// Standard deviation of the noise of time stamps, in seconds; for every camera.
    pub jitter_s: f64,
    /// Largest phase of the exposures relative to the first camera, in frames.
    pub phase: f64,
    /// Largest delay of the first exposure relative to the first camera, in seconds.
    pub late_start_s: f64,
    /// Fraction of lost frames; for every camera.
    pub drop_fraction: f64,
    /// Largest relative difference of frame rates.
    pub rate_spread: f64,
}

/// Photometric effects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotometryEffects {
    /// Amplitude of the automatic exposure, in stops.
    pub exposure_stops: f64,
    /// Standard deviation of the noise at white, relative to white.
    pub noise: f64,
    /// JPEG quality, 1 to 100; `None` for lossless images.
    pub jpeg_quality: Option<u8>,
}

/// All effects. The default has none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effects {
    /// Lens of an action camera, different for each camera, instead of the ideal pinhole.
    pub has_action_lens: bool,
    /// Root mean square of the lens field, in pixels: a smooth displacement of pixels, different
    /// for each camera and the same in all of its images, which no camera model describes.
    pub lens_field_px: f64,
    /// Readout time from the first row to the last, in seconds; 0 for a global shutter.
    pub readout_s: f64,
    /// Scale of the pitch, roll and heave of the body: 1 for a real car, 0 for none.
    pub suspension: f64,
    /// Amplitude of the 12 Hz vibration, in radians.
    pub vibration_rad: f64,
    /// Misaligned cameras: rotated by about 1.5 degrees about each axis.
    pub is_misaligned: bool,
    /// Amplitude of the swing of every camera but the first on a flexible mount, in radians. In no
    /// preset.
    pub flex_rad: f64,
    /// Number of moving cars.
    pub moving_cars: usize,
    /// Clock effects.
    pub clocks: ClockEffects,
    /// Photometric effects.
    pub photometry: PhotometryEffects,
}

impl Default for ClockEffects {
    fn default() -> Self {
        Self {
            offset_s: 0.0,
            drift_ppm: 0.0,
            jitter_s: 0.0,
            phase: 0.0,
            late_start_s: 0.0,
            drop_fraction: 0.0,
            rate_spread: 0.0,
        }
    }
}

impl Default for PhotometryEffects {
    fn default() -> Self {
        Self { exposure_stops: 0.0, noise: 0.0, jpeg_quality: None }
    }
}

impl Default for Effects {
    fn default() -> Self {
        Self {
            has_action_lens: false,
            lens_field_px: 0.0,
            readout_s: 0.0,
            suspension: 0.0,
            vibration_rad: 0.0,
            is_misaligned: false,
            flex_rad: 0.0,
            moving_cars: 0,
            clocks: ClockEffects::default(),
            photometry: PhotometryEffects::default(),
        }
    }
}

/// A function that switches an effect on.
pub type Switch = fn(&mut Effects);

impl Effects {
    /// The presets: name and effect. `all` combines them, except `lens-field`.
    pub const PRESETS: [(&'static str, Switch); 9] = [
        ("none", |_| {}),
        ("lens", |effects| effects.has_action_lens = true),
        // 16 ms: between a fast and an average action camera.
        ("rolling-shutter", |effects| effects.readout_s = 0.016),
        ("vibration", |effects| {
            effects.suspension = 1.0;
            effects.vibration_rad = 0.05f64.to_radians();
        }),
        ("misalignment", |effects| effects.is_misaligned = true),
        ("traffic", |effects| effects.moving_cars = 6),
        // Set by hand to 0.2 s; a quartz; the jitter of millisecond time stamps.
        ("clocks", |effects| {
            effects.clocks = ClockEffects {
                offset_s: 0.2,
                drift_ppm: 40.0,
                jitter_s: 0.0005,
                phase: 1.0,
                late_start_s: 0.5,
                drop_fraction: 0.01,
                rate_spread: 0.002,
            };
        }),
        ("photometry", |effects| {
            effects.photometry =
                PhotometryEffects { exposure_stops: 0.7, noise: 0.02, jpeg_quality: Some(92) };
        }),
        ("lens-field", |effects| effects.lens_field_px = 0.15),
    ];

    /// All presets combined, except `lens-field`: drives with all effects stay what they were.
    pub fn all() -> Self {
        let mut effects = Self::default();
        for (_, switch_on) in Self::PRESETS {
            switch_on(&mut effects);
        }
        Self { lens_field_px: 0.0, ..effects }
    }

    pub(crate) fn validate(&self) -> Result<(), Error> {
        let ClockEffects {
            offset_s,
            drift_ppm,
            jitter_s,
            phase,
            late_start_s,
            drop_fraction,
            rate_spread,
        } = self.clocks;
        require(
            (0.0..=1.0).contains(&self.lens_field_px),
            "lens_field_px",
            self.lens_field_px,
            "0 to 1",
        )?;
        let small = "0 to 0.2 s";
        require((0.0..=0.2).contains(&self.readout_s), "readout_s", self.readout_s, small)?;
        require((0.0..=3.0).contains(&self.suspension), "suspension", self.suspension, "0 to 3")?;
        require(
            (0.0..=0.1).contains(&self.vibration_rad),
            "vibration_rad",
            self.vibration_rad,
            "0 to 0.1",
        )?;
        require((0.0..=0.2).contains(&self.flex_rad), "flex_rad", self.flex_rad, "0 to 0.2")?;
        require((0.0..=3600.0).contains(&offset_s), "offset_s", offset_s, "0 to 3600 s")?;
        require((0.0..=1e4).contains(&drift_ppm), "drift_ppm", drift_ppm, "0 to 10000")?;
        require((0.0..=0.2).contains(&jitter_s), "jitter_s", jitter_s, small)?;
        require((0.0..=1.0).contains(&phase), "phase", phase, "0 to 1")?;
        require(
            (0.0..=3600.0).contains(&late_start_s),
            "late_start_s",
            late_start_s,
            "0 to 3600 s",
        )?;
        require((0.0..=0.9).contains(&drop_fraction), "drop_fraction", drop_fraction, "0 to 0.9")?;
        require((0.0..=0.5).contains(&rate_spread), "rate_spread", rate_spread, "0 to 0.5")?;
        let PhotometryEffects { exposure_stops, noise, jpeg_quality } = self.photometry;
        require((0.0..=3.0).contains(&exposure_stops), "exposure_stops", exposure_stops, "0 to 3")?;
        require((0.0..=0.5).contains(&noise), "noise", noise, "0 to 0.5")?;
        let quality = jpeg_quality.unwrap_or(100);
        require((1..=100).contains(&quality), "jpeg_quality", f64::from(quality), "1 to 100")
    }
}

/// Parses names of presets joined by `+`, such as `lens+clocks`, or `all`.
impl FromStr for Effects {
    type Err = Error;
    fn from_str(names: &str) -> Result<Self, Error> {
        if names == "all" {
            return Ok(Self::all());
        }
        let mut effects = Self::default();
        for name in names.split('+') {
            let preset = Self::PRESETS.into_iter().find(|(known, _)| *known == name);
            let (_, switch_on) = preset.ok_or_else(|| Error::UnknownName {
                what: "effect",
                name: name.to_owned(),
                known: Self::PRESETS.map(|(known, _)| known).join(", ") + ", all",
            })?;
            switch_on(&mut effects);
        }
        Ok(effects)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_distinct_and_combine_to_all() {
        let mut names: Vec<&str> = Effects::PRESETS.iter().map(|(name, _)| *name).collect();
        assert_eq!("none".parse::<Effects>().unwrap(), Effects::default());
        for name in &names[1..] {
            let effects: Effects = name.parse().unwrap();
            assert_ne!(effects, Effects::default(), "{name}");
            assert_ne!(effects, Effects::all(), "{name}");
            effects.validate().unwrap();
        }
        names.retain(|&name| name != "lens-field");
        names.reverse();
        assert_eq!(names.join("+").parse::<Effects>().unwrap(), Effects::all());
        assert!("rain".parse::<Effects>().is_err());
    }
}
