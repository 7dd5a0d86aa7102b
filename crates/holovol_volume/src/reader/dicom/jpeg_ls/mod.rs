//! JPEG-LS (ITU-T T.87), one component, lossless and near-lossless.
//!
//! Own code: the crates that decode it are bindings to C++, or bring a DICOM toolkit with a
//! logging system along. Names follow the standard's.

mod scan;

use scan::Scan;

type Problem = &'static str;

/// A decoded image.
#[derive(Debug)]
pub(super) struct Decoded {
    pub samples: Vec<u16>,
    pub precision: u8,
}

/// Decodes an image of `width` × `height` samples.
pub(super) fn decode(bytes: &[u8], width: usize, height: usize) -> Result<Decoded, Problem> {
    let mut markers = Markers { bytes, at: 0 };
    if markers.next()? != 0xd8 {
        return Err("it does not begin like a JPEG");
    }
    let mut frame = None;
    let mut presets = Presets::default();
    loop {
        match markers.next()? {
            0xf7 => {
                let [precision, h1, h0, w1, w0, components, ..] = *markers.segment()? else {
                    return Err("the frame header is too short");
                };
                let size = |high: u8, low: u8| usize::from(u16::from_be_bytes([high, low]));
                if components != 1 {
                    return Err("it has more than one component");
                }
                if (size(w1, w0), size(h1, h0)) != (width, height) {
                    return Err("its size is not that of the frame");
                }
                if !(2..=16).contains(&precision) {
                    return Err("its precision is not 2 to 16 bits");
                }
                frame = Some(precision);
            }
            0xf8 => presets.read(markers.segment()?)?,
            0xdd => return Err("restart markers are not supported"),
            0xda => {
                let precision = frame.ok_or("a scan comes before its frame header")?;
                let [1, _, table, near, interleave, transform] = *markers.segment()? else {
                    return Err("the scan header does not fit one component");
                };
                if table != 0 || interleave != 0 || transform != 0 {
                    return Err("mapping tables and point transforms are not supported");
                }
                let parameters = Parameters::new(&presets, precision, near.into())?;
                let rest = bytes.get(markers.at..).unwrap_or_default();
                let samples = Scan::new(parameters, rest).image(width, height)?;
                return Ok(Decoded { samples, precision });
            }
            0xd9 => return Err("it ends before its scan"),
            _ => {
                markers.segment()?;
            }
        }
    }
}

struct Markers<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Markers<'a> {
    fn next(&mut self) -> Result<u8, Problem> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let fill = rest.iter().take_while(|&&byte| byte == 0xff).count();
        let marker = *rest.get(fill).ok_or("it ends within its headers")?;
        if fill == 0 {
            return Err("a marker is missing");
        }
        self.at += fill + 1;
        Ok(marker)
    }

    fn segment(&mut self) -> Result<&'a [u8], Problem> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let length = rest.first_chunk().map(|length| u16::from_be_bytes(*length));
        let length = usize::from(length.ok_or("it ends within its headers")?);
        let segment = rest.get(2..length).ok_or("a header is cut off")?;
        self.at += length;
        Ok(segment)
    }
}

/// What an LSE segment may set; 0 for the default.
#[derive(Default)]
struct Presets {
    maxval: i32,
    thresholds: [i32; 3],
    reset: i32,
}

impl Presets {
    fn read(&mut self, segment: &[u8]) -> Result<(), Problem> {
        let [1, numbers @ ..] = segment else {
            return Err("mapping tables are not supported");
        };
        let number = |index: usize| {
            let bytes = numbers.get(2 * index..).and_then(|rest| rest.first_chunk());
            bytes.map_or(0, |bytes| i32::from(u16::from_be_bytes(*bytes)))
        };
        self.maxval = number(0);
        self.thresholds = [number(1), number(2), number(3)];
        self.reset = number(4);
        Ok(())
    }
}

#[derive(Clone, Copy)]
pub(super) struct Parameters {
    maxval: i32,
    near: i32,
    range: i32,
    qbpp: u32,
    limit: u32,
    thresholds: [i32; 3],
    reset: i32,
}

impl Parameters {
    fn new(presets: &Presets, precision: u8, near: i32) -> Result<Self, Problem> {
        let full = (1 << precision) - 1;
        let maxval = if presets.maxval == 0 {
            full
        } else {
            presets.maxval
        };
        if maxval > full || near > (maxval / 2).min(255) {
            return Err("its parameters are out of range");
        }
        let range = (maxval + 2 * near) / (2 * near + 1) + 1;
        let bpp = bits(maxval + 1).max(2);
        let defaults = default_thresholds(maxval, near);
        let mut thresholds = presets.thresholds;
        for (threshold, default) in thresholds.iter_mut().zip(defaults) {
            if *threshold == 0 {
                *threshold = default;
            }
        }
        let [t1, t2, t3] = thresholds;
        if t1 < near + 1 || t2 < t1 || t3 < t2 || t3 > maxval.max(near + 1) {
            return Err("its thresholds are out of range");
        }
        let reset = if presets.reset == 0 {
            64
        } else {
            presets.reset
        };
        if reset < 3 {
            return Err("its reset interval is out of range");
        }
        Ok(Self {
            maxval,
            near,
            range,
            qbpp: bits(range),
            limit: 2 * (bpp + bpp.max(8)),
            thresholds,
            reset,
        })
    }
}

/// ⌈log₂ n⌉.
fn bits(n: i32) -> u32 {
    32 - (n - 1).max(0).leading_zeros()
}

/// T.87, C.2.4.1.1.1.
fn default_thresholds(maxval: i32, near: i32) -> [i32; 3] {
    const BASIC: [i32; 3] = [3, 7, 21];
    let within = |value: i32, low: i32| {
        if value > maxval || value < low {
            low
        } else {
            value
        }
    };
    let mut low = near + 1;
    let mut thresholds = [0; 3];
    for (index, (threshold, basic)) in thresholds.iter_mut().zip(BASIC).enumerate() {
        let weight = 2 * index as i32 + 3;
        let value = if maxval >= 128 {
            let factor = (maxval.min(4095) + 128) / 256;
            factor * (basic - index as i32 - 2) + index as i32 + 2 + weight * near
        } else {
            let factor = 256 / (maxval + 1);
            (index as i32 + 2).max(basic / factor + weight * near)
        };
        low = within(value, low);
        *threshold = low;
    }
    thresholds
}
