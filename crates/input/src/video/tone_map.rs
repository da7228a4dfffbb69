//! Tone mapping of high dynamic range (ITU-R BT.2100) to eight bits a channel.
//!
//! PQ and HLG code values become display light, with the OOTF of BT.2100 for HLG. BT.2020 primaries
//! become those of BT.709. The EETF of BT.2390-10 (5.4.1) compresses the largest channel of a pixel
//! to the white of standard range, and the others in proportion, so that hues stay. The result is
//! encoded for a display by BT.1886. It is done here rather than by filters of ffmpeg, because many
//! builds lack them, and because the frames are then the same with every build.

/// Transfer function of an image of high dynamic range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transfer {
    /// Hybrid log-gamma (ARIB STD-B67).
    Hlg,
    /// Perceptual quantiser (SMPTE ST 2084).
    Pq,
}

/// Luminance of the brightest pixels in cd/m²: the nominal peak of HLG (BT.2100), and that which
/// most PQ content is mastered for. Brighter pixels become white. It decides how much highlights
/// are compressed: the white of a page (203 cd/m²) gets the code value 230 with it, 245 with half
/// of it and 222 with twice as much.
const PEAK_CD_M2: f64 = 1000.0;
/// Reference white of high dynamic range (BT.2408), which white of standard range corresponds to.
const WHITE_CD_M2: f64 = 203.0;
/// Largest luminance of PQ.
const PQ_MAX_CD_M2: f64 = 10_000.0;
/// Exponent of the OOTF of HLG, less 1, for a peak of 1000 cd/m².
const HLG_GAMMA_LESS_1: f64 = 0.2;
/// Exponent of BT.1886.
const DISPLAY_GAMMA: f64 = 2.4;
/// Luminance of linear BT.2020.
const LUMINANCE: [f32; 3] = [0.2627, 0.6780, 0.0593];
/// BT.709 from BT.2020, of linear light (BT.2087).
const BT709_FROM_BT2020: [[f32; 3]; 3] =
    [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]];
/// Entries of the tables over light, which are indexed by its square root.
const ENTRIES: usize = 4096;

/// Tables of a transfer function.
pub(crate) struct ToneMap {
    /// Light of a code value of 16 bits: a share of the peak, for HLG before its OOTF.
    light: Vec<f32>,
    /// Gain of the OOTF of HLG by luminance; empty for PQ.
    ootf: Vec<f32>,
    /// Light as a share of white over light as a share of the peak, by the latter.
    gain: Vec<f32>,
    /// Code value by light as a share of white.
    code: Vec<u8>,
}

impl ToneMap {
    pub(crate) fn new(transfer: Transfer) -> Self {
        let codes = (0..=u16::MAX).map(|code| f64::from(code) / f64::from(u16::MAX));
        let of_roots = |value: &dyn Fn(f64) -> f64| -> Vec<f32> {
            let root = |index| index as f64 / (ENTRIES - 1) as f64;
            (0..ENTRIES).map(|index| value(root(index).powi(2)) as f32).collect()
        };
        let light = match transfer {
            Transfer::Hlg => codes.map(|code| hlg_light(code) as f32).collect(),
            Transfer::Pq => codes.map(|code| (pq_cd_m2(code) / PEAK_CD_M2) as f32).collect(),
        };
        let ootf = match transfer {
            Transfer::Hlg => of_roots(&|luminance| luminance.powf(HLG_GAMMA_LESS_1)),
            Transfer::Pq => Vec::new(),
        };
        // In the dark the curve is the identity.
        let least = 1.0 / PEAK_CD_M2;
        let gain = of_roots(&|light| {
            let light = light.max(least);
            mapped_cd_m2(light * PEAK_CD_M2) / (light * WHITE_CD_M2)
        });
        let code = of_roots(&|light| 255.0 * light.powf(1.0 / DISPLAY_GAMMA));
        let code = code.into_iter().map(|code| code.round() as u8).collect();
        Self { light, ootf, gain, code }
    }

    /// Maps a pixel of code values of 16 bits.
    pub(crate) fn map(&self, pixel: [u16; 3]) -> [u8; 3] {
        let mut light = pixel.map(|code| self.light[usize::from(code)]);
        if !self.ootf.is_empty() {
            let luminance = dot(LUMINANCE, light);
            let gain = at(&self.ootf, luminance);
            light = light.map(|light| light * gain);
        }
        let light = BT709_FROM_BT2020.map(|row| dot(row, light).max(0.0));
        let gain = at(&self.gain, light[0].max(light[1]).max(light[2]));
        light.map(|light| at(&self.code, light * gain))
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The nearest entry of a table over the square root of light.
fn at<T: Copy>(table: &[T], light: f32) -> T {
    table[(light.clamp(0.0, 1.0).sqrt() * (ENTRIES - 1) as f32 + 0.5) as usize]
}

/// Inverse OETF of HLG (BT.2100, table 5): light of the scene, 0 to 1.
fn hlg_light(code: f64) -> f64 {
    const A: f64 = 0.178_832_77;
    const B: f64 = 1.0 - 4.0 * A;
    let c = 0.5 - A * (4.0 * A).ln();
    if code <= 0.5 { code * code / 3.0 } else { (((code - c) / A).exp() + B) / 12.0 }
}

/// Constants of PQ (BT.2100, table 4).
const M1: f64 = 2610.0 / 16_384.0;
const M2: f64 = 2523.0 / 4096.0 * 128.0;
const C1: f64 = 3424.0 / 4096.0;
const C2: f64 = 2413.0 / 4096.0 * 32.0;
const C3: f64 = 2392.0 / 4096.0 * 32.0;

/// EOTF of PQ, in cd/m².
fn pq_cd_m2(code: f64) -> f64 {
    let root = code.powf(1.0 / M2);
    PQ_MAX_CD_M2 * ((root - C1).max(0.0) / (C2 - C3 * root)).powf(1.0 / M1)
}

/// Inverse of [`pq_cd_m2`].
fn pq_code(cd_m2: f64) -> f64 {
    let power = (cd_m2 / PQ_MAX_CD_M2).powf(M1);
    ((C1 + C2 * power) / (1.0 + C3 * power)).powf(M2)
}

/// EETF of BT.2390: luminance on a display whose peak is [`WHITE_CD_M2`].
fn mapped_cd_m2(cd_m2: f64) -> f64 {
    let peak = pq_code(PEAK_CD_M2);
    let (e, max) = ((pq_code(cd_m2) / peak).min(1.0), pq_code(WHITE_CD_M2) / peak);
    let knee = 1.5 * max - 0.5;
    let mapped = if e < knee {
        e
    } else {
        let t = (e - knee) / (1.0 - knee);
        let (t2, t3) = (t * t, t * t * t);
        (2.0 * t3 - 3.0 * t2 + 1.0) * knee
            + (t3 - 2.0 * t2 + t) * (1.0 - knee)
            + (3.0 * t2 - 2.0 * t3) * max
    };
    pq_cd_m2(mapped * peak)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The code value of 16 bits for a code of 0 to 1.
    fn grey(code: f64) -> [u16; 3] {
        [(code * f64::from(u16::MAX)).round() as u16; 3]
    }

    #[test]
    fn code_values_are_those_of_the_standards() {
        // BT.2408, table 1: reference white is 58 % of PQ and 75 % of HLG.
        assert!((pq_code(203.0) - 0.58).abs() < 0.002, "{}", pq_code(203.0));
        assert!((pq_cd_m2(pq_code(203.0)) - 203.0).abs() < 1e-6);
        let hlg = 1000.0 * hlg_light(0.75).powf(1.0 + HLG_GAMMA_LESS_1);
        assert!((hlg - 203.0).abs() < 1.0, "{hlg}");
        assert!((hlg_light(1.0) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn tones_rise_from_black_to_white_and_both_transfers_agree() {
        let (hlg, pq) = (ToneMap::new(Transfer::Hlg), ToneMap::new(Transfer::Pq));
        for map in [&hlg, &pq] {
            assert_eq!((map.map(grey(0.0)), map.map(grey(1.0))), ([0; 3], [255; 3]));
            let tones: Vec<[u8; 3]> =
                (0..=100).map(|k| map.map(grey(f64::from(k) / 100.0))).collect();
            assert!(tones.windows(2).all(|two| two[0][1] <= two[1][1]), "{tones:?}");
            assert!(tones.iter().all(|t| t[0].abs_diff(t[1]).max(t[2].abs_diff(t[1])) <= 1));
        }
        // The same light: reference white.
        let (a, b) = (hlg.map(grey(0.75))[1], pq.map(grey(pq_code(203.0)))[1]);
        assert!(a.abs_diff(b) <= 1, "{a} {b}");
        assert_eq!(b, 230);
    }

    #[test]
    fn hues_stay() {
        // A red of BT.2020 within BT.709, dark and bright.
        let map = ToneMap::new(Transfer::Pq);
        for scale in [30.0, 800.0] {
            let code = |share: f64| grey(pq_code(scale * share))[0];
            let [r, g, b] = map.map([code(1.0), code(0.4), code(0.4)]);
            assert!(r > g && g.abs_diff(b) < 12, "{r} {g} {b}");
        }
    }
}
