//! What makes a drive unlike a textbook: each effect can be switched on alone.

use std::str::FromStr;

use crate::Error;
use crate::error::require;

/// How cameras' clocks and triggers differ. Values are the largest; each camera but the first draws
/// its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockEffects {
    /// Clocks are set differently by up to this, in seconds, either way.
    pub offset_s: f64,
    /// Clocks run differently by up to this, in parts per million, either way.
    pub drift_ppm: f64,
    /// Standard deviation of what a stamp says beside the truth, in seconds; of every camera.
    pub jitter_s: f64,
    /// Cameras expose up to this much later than the first, in frames.
    pub phase: f64,
    /// Cameras start up to this much later than the first, in seconds.
    pub late_start_s: f64,
    /// Share of the frames that are lost; of every camera.
    pub drop_fraction: f64,
    /// Frame rates differ by up to this share, either way.
    pub rate_spread: f64,
}

/// What happens to the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotometryEffects {
    /// Automatic exposure wanders by up to this, in stops, either way.
    pub exposure_stops: f64,
    /// Noise at white, relative to white.
    pub noise: f64,
    /// Quality of the JPEG, 1 to 100; `None` for images as they are.
    pub jpeg_quality: Option<u8>,
}

/// All effects. The default is none of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effects {
    /// An action camera's lens, each camera its own, instead of the ideal pinhole.
    pub has_action_lens: bool,
    /// Time from the first row to the last, in seconds; 0 is a global shutter.
    pub readout_s: f64,
    /// Body pitch, roll and heave: 1 as a car's.
    pub suspension: f64,
    /// Amplitude of the 12 Hz vibration, in radians.
    pub vibration_rad: f64,
    /// Cameras fixed by hand: turned by about 1.5 degrees.
    pub is_misaligned: bool,
    /// Every camera but the first swings about its place by up to this, in radians, either way: a
    /// mount that gives. In no preset.
    pub flex_rad: f64,
    /// Cars that drive through the picture.
    pub moving_cars: usize,
    /// Clocks and triggers.
    pub clocks: ClockEffects,
    /// Light.
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

/// Switches something on.
pub type Switch = fn(&mut Effects);

impl Effects {
    /// Every preset: its name and what it switches on. `all` is all of them together.
    pub const PRESETS: [(&'static str, Switch); 8] = [
        ("none", |_| {}),
        ("lens", |effects| effects.has_action_lens = true),
        // 16 ms: between a good and a usual action camera.
        ("rolling-shutter", |effects| effects.readout_s = 0.016),
        ("vibration", |effects| {
            effects.suspension = 1.0;
            effects.vibration_rad = 0.05f64.to_radians();
        }),
        ("mounting", |effects| effects.is_misaligned = true),
        ("traffic", |effects| effects.moving_cars = 6),
        // Set by hand to a fifth of a second; quartz; the jitter of a file's millisecond stamps.
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
    ];

    /// Every effect together.
    pub fn all() -> Self {
        let mut effects = Self::default();
        for (_, switch_on) in Self::PRESETS {
            switch_on(&mut effects);
        }
        effects
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

/// Names of presets, joined by `+`: `lens+clocks`; or `all`.
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
    fn presets_switch_on_one_thing_each_and_add_up() {
        let mut names: Vec<&str> = Effects::PRESETS.iter().map(|(name, _)| *name).collect();
        assert_eq!("none".parse::<Effects>().unwrap(), Effects::default());
        for name in &names[1..] {
            let effects: Effects = name.parse().unwrap();
            assert_ne!(effects, Effects::default(), "{name}");
            assert_ne!(effects, Effects::all(), "{name}");
            effects.validate().unwrap();
        }
        names.reverse();
        assert_eq!(names.join("+").parse::<Effects>().unwrap(), Effects::all());
        assert!("rain".parse::<Effects>().is_err());
    }
}
