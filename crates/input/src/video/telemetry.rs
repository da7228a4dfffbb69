//! What a GoPro measures beside the picture: positions, gravity, orientations.
//!
//! The track of format `gpmd` has a payload for each second, whose records are in containers: a
//! device `DEVC`, in it a stream `STRM`, in which the record with the measurements is the last one,
//! behind those that describe it. Records `STMP` are the time of the first measurement in a
//! payload, in microseconds of a clock that all streams share, and `TSMP` the number of
//! measurements up to its end. The exposure times `SHUT` have one measurement for each frame of the
//! video, so that their first one tells that clock's time of the first frame. Without `STMP` the
//! measurements of a payload are spread over its time.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek};
use std::path::Path;

use tiepoint_io::{Error, Result};
use tiepoint_scene::{Place, Position, PositionTrack};

use super::gopro::read_settings;
use super::klv::{MAX_DEPTH, Record, for_each_record, records};
use super::mp4::{Sample, read_range, samples};

/// Measurements with their times since the beginning of the video, in seconds.
pub type Measurements = Vec<(f64, Vec<f64>)>;

/// The measurements of a camera, by the keys of their streams.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Telemetry {
    streams: BTreeMap<[u8; 4], Measurements>,
    readout_s: Option<f64>,
}

impl Telemetry {
    /// Reads the telemetry of a video; `None` if it has none, whatever its format.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the file cannot be read.
    pub fn read(path: &Path) -> Result<Option<Self>> {
        let file = File::open(path).map_err(Error::io(path))?;
        let length = file.metadata().map_err(Error::io(path))?.len();
        Self::of_file(&mut BufReader::new(file), length).map_err(Error::io(path))
    }

    fn of_file(file: &mut (impl Read + Seek), length: u64) -> io::Result<Option<Self>> {
        let Some(samples) = samples(file, length, b"gpmd")? else { return Ok(None) };
        let mut payloads = Vec::new();
        // Samples do not overlap: a hostile table may name the same bytes again and again.
        let mut left = length;
        for sample in samples {
            left = match left.checked_sub(sample.bytes.end - sample.bytes.start) {
                Some(left) => left,
                None => break,
            };
            // A truncated file has the payloads before its end.
            if sample.bytes.end <= length
                && let Some(bytes) = read_range(file, sample.bytes.clone())?
            {
                payloads.push((sample, bytes));
            }
        }
        let settings = read_settings(file, length)?;
        Ok(Some(Self::of_payloads(&payloads, settings.as_deref())))
    }

    fn of_payloads(payloads: &[(Sample, Vec<u8>)], settings: Option<&[u8]>) -> Self {
        let mut blocks: BTreeMap<[u8; 4], Vec<Block>> = BTreeMap::new();
        for (sample, bytes) in payloads {
            for_each_stream(bytes, 0, &mut |stream| {
                if let Some((key, elements, stamp)) = measurements_of(stream)
                    && KEYS.contains(&&key)
                {
                    let times_s = sample.times_s.clone();
                    let of_key = blocks.entry(key).or_default();
                    of_key.push(Block { times_s, stamp, elements });
                }
            });
        }
        let first_frame_us = blocks
            .get(b"SHUT")
            .and_then(|blocks| blocks.first())
            .filter(|block| block.times_s.start == 0.0)
            .and_then(|block| Some(block.stamp?.first_us));
        let streams: BTreeMap<_, _> =
            blocks.iter().map(|(key, blocks)| (*key, timed(blocks, first_frame_us))).collect();
        let of_settings = settings.and_then(|settings| {
            let mut found = None;
            for_each_record(settings, 0, &mut |record| {
                if record.key == *b"SROT" {
                    found = record.numbers().first().copied();
                }
            });
            found
        });
        let of_stream = || streams.get(b"SROT")?.first()?.1.first().copied();
        let readout_s = of_settings.or_else(of_stream).map(|milliseconds| milliseconds / 1e3);
        Self { readout_s: readout_s.filter(|time_s| time_s.is_finite()), streams }
    }

    /// The measurements of a stream, as `GRAV` (the direction of gravity), `CORI` (the orientation
    /// of the camera, a quaternion from w on) and `GPS5`; empty if there is none.
    pub fn measurements(&self, key: &[u8; 4]) -> &[(f64, Vec<f64>)] {
        self.streams.get(key).map_or(&[], Vec::as_slice)
    }

    /// How long the sensor takes to read a frame.
    pub fn readout_s(&self) -> Option<f64> {
        self.readout_s
    }

    /// The positions where the receiver had a fix; those with two-dimensional ones have no
    /// altitude. Their DOP describes the satellites, and not their errors.
    pub fn positions(&self) -> PositionTrack {
        let of = |key: &[u8; 4], fix_at: usize| {
            self.measurements(key).iter().filter_map(move |(time_s, values)| {
                let fix = *values.get(fix_at)?;
                let [latitude_deg, longitude_deg, altitude_m] = *values.first_chunk()?;
                let altitude_m = (fix >= 3.0).then_some(altitude_m);
                let place = Place::Geodetic { latitude_deg, longitude_deg, altitude_m };
                let is_fixed = fix >= 2.0 && place.validate().is_ok() && !place.is_null();
                let position = Position { place, sigma_horizontal_m: None, sigma_vertical_m: None };
                is_fixed.then_some((*time_s, position))
            })
        };
        // A HERO11 records both, at other times, of one receiver.
        match self.measurements(b"GPS9") {
            [] => PositionTrack::new(of(b"GPS5", GPS5_FIX)),
            _ => PositionTrack::new(of(b"GPS9", GPS9_FIX)),
        }
    }
}

/// The streams that are kept: those of the gyroscope and of the accelerometer are large, and nobody
/// uses them.
const KEYS: [&[u8; 4]; 6] = [b"GPS5", b"GPS9", b"GRAV", b"CORI", b"SHUT", b"SROT"];

/// Where the kind of fix is: in GPS9 behind latitude, longitude, altitude, two speeds, days,
/// seconds and DOP; in GPS5, behind latitude, longitude, altitude and two speeds, it is put there
/// from the record `GPSF` of the payload.
const GPS9_FIX: usize = 8;
const GPS5_FIX: usize = 5;

/// The measurements of a stream in one payload.
struct Block {
    /// When the payload begins and ends.
    times_s: std::ops::Range<f64>,
    stamp: Option<Stamp>,
    elements: Vec<Vec<f64>>,
}

/// When the first measurement of a payload was, and how many there were up to its end.
#[derive(Clone, Copy)]
struct Stamp {
    first_us: f64,
    total: Option<f64>,
}

/// The measurements of all payloads with their times.
fn timed(blocks: &[Block], first_frame_us: Option<f64>) -> Measurements {
    let mut measurements = Measurements::new();
    let stamped = first_frame_us.and_then(|first_us| stamped(blocks, first_us));
    for (index, block) in blocks.iter().enumerate() {
        let count = block.elements.len() as f64;
        let (start_s, step_s) = match &stamped {
            Some(stamped) => stamped[index],
            None => (block.times_s.start, (block.times_s.end - block.times_s.start) / count),
        };
        let time_s = |k: usize| start_s + k as f64 * step_s;
        let of_block = block.elements.iter().enumerate();
        measurements.extend(of_block.map(|(k, element)| (time_s(k), element.clone())));
    }
    measurements
}

/// The time of the first measurement of each payload, and the interval, by their stamps; `None`
/// if one has none.
fn stamped(blocks: &[Block], first_frame_us: f64) -> Option<Vec<(f64, f64)>> {
    let stamps: Vec<Stamp> = blocks.iter().map(|block| block.stamp).collect::<Option<_>>()?;
    let mut found = Vec::new();
    for (index, stamp) in stamps.iter().enumerate() {
        let step_us = stamps.get(index + 1).map_or(f64::NAN, |next| {
            // Of measurements that were lost on the way, the totals know.
            let lost =
                || Some(next.total? - blocks[index + 1].elements.len() as f64 - stamp.total?);
            let count = blocks[index].elements.len() as f64 + lost().unwrap_or(0.0).max(0.0);
            (next.first_us - stamp.first_us) / count
        });
        let step_s = match (step_us.is_finite() && step_us > 0.0, found.last()) {
            (true, _) => step_us / 1e6,
            (false, Some((_, before_s))) => *before_s,
            // The only payload.
            (false, None) => return None,
        };
        found.push(((stamp.first_us - first_frame_us) / 1e6, step_s));
    }
    Some(found)
}

/// Calls for the content of each stream.
fn for_each_stream(bytes: &[u8], depth: usize, f: &mut impl FnMut(&[u8])) {
    for record in records(bytes).filter(Record::is_container) {
        match &record.key {
            b"STRM" => f(record.content),
            _ if depth < MAX_DEPTH => for_each_stream(record.content, depth + 1, f),
            _ => {}
        }
    }
}

/// The key of a stream, its measurements in their units, and their stamp.
type OfStream = ([u8; 4], Vec<Vec<f64>>, Option<Stamp>);

/// The measurements of a stream.
fn measurements_of(stream: &[u8]) -> Option<OfStream> {
    let key = records(stream).last()?.key;
    let (mut scales, mut letters, mut fix) = (Vec::new(), None, None);
    let (mut first_us, mut total) = (None, None);
    let mut elements = Vec::new();
    for record in records(stream) {
        match &record.key {
            b"SCAL" => scales = record.numbers(),
            b"TYPE" => letters = Some(record.content),
            b"STMP" => first_us = record.numbers().first().copied(),
            b"TSMP" => total = record.numbers().first().copied(),
            b"GPSF" => fix = record.numbers().first().copied(),
            // Some streams have a record for each frame.
            other if *other == key => elements.extend(record.elements(letters)),
            _ => {}
        }
    }
    let scale = |k: usize| {
        let scale = scales.get(if scales.len() == 1 { 0 } else { k }).copied().unwrap_or(1.0);
        if scale == 0.0 { 1.0 } else { scale }
    };
    for element in &mut elements {
        element.iter_mut().enumerate().for_each(|(k, value)| *value /= scale(k));
        if key == *b"GPS5" {
            element.extend(fix);
        }
    }
    let stamp = first_us.map(|first_us| Stamp { first_us, total });
    Some((key, elements, stamp))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::klv::tests::record;
    use super::super::mp4::tests::{mp4_box, track};
    use super::*;

    fn longs(list: &[i32]) -> Vec<u8> {
        list.iter().flat_map(|number| number.to_be_bytes()).collect()
    }

    fn shorts(list: &[i16]) -> Vec<u8> {
        list.iter().flat_map(|number| number.to_be_bytes()).collect()
    }

    fn container(name: &[u8; 4], content: &[Vec<u8>]) -> Vec<u8> {
        record(name, 0, 1, &content.concat())
    }

    /// A stream with its time stamp, if there is one, and the number of measurements so far.
    fn stream(stamp: Option<(u64, u32)>, records: &[Vec<u8>]) -> Vec<u8> {
        let mut content = Vec::new();
        if let Some((first_us, total)) = stamp {
            content.push(record(b"STMP", b'J', 8, &first_us.to_be_bytes()));
            content.push(record(b"TSMP", b'L', 4, &total.to_be_bytes()));
        }
        content.extend_from_slice(records);
        container(b"STRM", &content)
    }

    /// A video with these payloads of 1001 ms, and a readout time in its settings.
    fn video(payloads: &[Vec<u8>]) -> Vec<u8> {
        let payloads: Vec<Vec<u8>> = payloads
            .iter()
            .map(|streams| {
                container(b"DEVC", &[record(b"DVNM", b'c', 1, b"Hero"), streams.clone()])
            })
            .collect();
        let sizes: Vec<u32> = payloads.iter().map(|payload| payload.len() as u32).collect();
        let mdat = mp4_box(b"mdat", &payloads.concat());
        let settings = container(b"DEVC", &[record(b"SROT", b'f', 4, &12.5f32.to_be_bytes())]);
        let udta = mp4_box(b"udta", &mp4_box(b"GPMF", &settings));
        let moov = mp4_box(b"moov", &[track(b"gpmd", &sizes, 8, 1001), udta].concat());
        [mdat, moov].concat()
    }

    fn telemetry_of(bytes: &[u8]) -> Option<Telemetry> {
        Telemetry::of_file(&mut io::Cursor::new(bytes), bytes.len() as u64).unwrap()
    }

    fn gps5(fix: u32, elements: &[[i32; 5]]) -> [Vec<u8>; 3] {
        [
            record(b"GPSF", b'L', 4, &fix.to_be_bytes()),
            record(b"SCAL", b'l', 4, &longs(&[10_000_000, 10_000_000, 1000, 1000, 100])),
            record(b"GPS5", b'l', 20, &longs(&elements.concat())),
        ]
    }

    /// Three payloads of a camera with time stamps; a measurement of the receiver is lost
    /// behind the first one, and it has no fix in the third one, and a flat one in the fourth.
    fn stamped_video() -> Vec<u8> {
        let payload = |index: u64, at_us: u64, total: u32, gps: [Vec<u8>; 3]| {
            let frames = shorts(&[1, 1]);
            let shutter = record(b"SHUT", b's', 2, &frames);
            let scale = record(b"SCAL", b's', 2, &shorts(&[32767]));
            let gravity = record(b"GRAV", b's', 6, &shorts(&[0, 32767, 0, 32767, 0, 0]));
            let frame_stamp = (85_608 + 1_001_000 * index, 2 * (index as u32 + 1));
            [
                stream(Some(frame_stamp), &[shutter]),
                stream(Some(frame_stamp), &[scale, gravity]),
                stream(Some((at_us, total)), &gps),
            ]
            .concat()
        };
        let at = |k: i32| [331_267_700 + k, -1_173_273_436, -22_959, 1046, 100];
        video(&[
            payload(0, 185_608, 2, gps5(3, &[at(0), at(1)])),
            payload(1, 1_685_608, 4, gps5(3, &[at(2)])),
            payload(2, 2_185_608, 6, gps5(0, &[at(3), at(4)])),
            payload(3, 3_185_608, 8, gps5(2, &[at(5), at(6)])),
        ])
    }

    #[test]
    fn measurements_have_the_times_of_their_stamps() {
        let found = telemetry_of(&stamped_video()).unwrap();
        assert_eq!(found.readout_s(), Some(0.0125));
        let times: Vec<f64> =
            found.measurements(b"GPS5").iter().map(|(time_s, _)| *time_s).collect();
        // Half a second apart, a tenth behind the first frame; one is lost behind the second one.
        let expected = [0.1, 0.6, 1.6, 2.1, 2.6, 3.1, 3.6];
        assert!(times.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{times:?}");
        let gravity = found.measurements(b"GRAV");
        assert_eq!(gravity[..2], [(0.0, vec![0.0, 1.0, 0.0]), (0.5005, vec![1.0, 0.0, 0.0])]);
        assert_eq!(found.measurements(b"CORI"), []);
        let positions = found.positions();
        let altitudes = positions.positions().iter().map(|position| match position.place {
            Place::Geodetic { latitude_deg, longitude_deg, altitude_m } => {
                assert!((latitude_deg - 33.12677).abs() < 1e-6 && longitude_deg == -117.327_343_6);
                altitude_m
            }
            Place::Cartesian(_) => None,
        });
        let altitudes: Vec<Option<f64>> = altitudes.collect();
        assert_eq!(altitudes, [Some(-22.959), Some(-22.959), Some(-22.959), None, None]);
        assert_eq!(positions.times_s().len(), 5);
    }

    #[test]
    fn positions_of_new_cameras_have_a_fix_each_and_are_spread_over_their_payload() {
        let element = |latitude: i32, fix: u16| {
            [
                longs(&[latitude, 20_000_000, 5000, 0, 0, 9000, 43_200_000]),
                [500u16, fix].iter().flat_map(|number| number.to_be_bytes()).collect(),
            ]
            .concat()
        };
        let payload = |elements: &[Vec<u8>]| {
            let scales = longs(&[10_000_000, 10_000_000, 1000, 1000, 100, 1, 1000, 100, 1]);
            let new = [
                record(b"TYPE", b'c', 1, b"lllllllSS"),
                record(b"SCAL", b'l', 4, &scales),
                record(b"GPS9", b'?', 32, &elements.concat()),
            ];
            // A HERO11 also records the older stream, which does not count.
            let old = gps5(3, &[[330_000_000, 20_000_000, 0, 0, 0]; 3]);
            [stream(None, &new), stream(None, &old)].concat()
        };
        let bytes = video(&[
            payload(&[element(10_000_000, 3), element(0, 0)]),
            payload(&[element(10_000_010, 2), element(910_000_000, 3)]),
        ]);
        let found = telemetry_of(&bytes).unwrap().positions();
        // Neither one without a fix, nor one beyond the pole.
        assert_eq!(found.times_s(), [0.0, 1.001]);
        let place = |latitude_deg, altitude_m| Place::Geodetic {
            latitude_deg,
            longitude_deg: 2.0,
            altitude_m,
        };
        let places: Vec<Place> = found.positions().iter().map(|position| position.place).collect();
        assert_eq!(places, [place(1.0, Some(5.0)), place(1.000_001, None)]);
        assert_eq!(telemetry_of(&mp4_box(b"moov", b"")), None);
    }

    proptest! {
        #[test]
        fn damaged_files_do_not_panic(at in 0usize..2000, byte: u8, end in 1usize..2000) {
            let mut bytes = stamped_video();
            bytes.truncate(end);
            let at = at % bytes.len();
            bytes[at] = byte;
            let mut file = io::Cursor::new(&bytes);
            if let Ok(Some(found)) = Telemetry::of_file(&mut file, bytes.len() as u64) {
                found.positions();
            }
        }
    }
}
