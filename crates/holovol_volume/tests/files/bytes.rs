//! Small files made in memory.

use std::io::Write;
use std::path::Path;

use holovol_volume::{Input, ReadOptions, Volume, VolumeError};

/// A number as files hold it.
pub trait Number: Copy {
    /// Its bytes, highest first if `big`.
    fn bytes(self, big: bool) -> Vec<u8>;
}

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Number for $number {
            fn bytes(self, big: bool) -> Vec<u8> {
                if big { self.to_be_bytes().to_vec() } else { self.to_le_bytes().to_vec() }
            }
        }
    )*};
}
numbers!(u8, i8, u16, i16, u32, i32, u64, i64, f32, f64);

pub fn all_bytes<T: Number>(numbers: &[T], big: bool) -> Vec<u8> {
    numbers.iter().flat_map(|n| n.bytes(big)).collect()
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).expect("a Vec takes all");
    encoder.finish().expect("a Vec takes all")
}

pub fn read(bytes: &[u8]) -> Result<Volume, VolumeError> {
    let input = Input::from_bytes(Path::new("memory"), bytes);
    holovol_volume::read(input, &ReadOptions::default(), &mut |_| {})
}

/// Reads what must be fine.
pub fn good(bytes: &[u8]) -> Volume {
    read(bytes).unwrap_or_else(|error| panic!("{error}"))
}

/// The message for what must not be fine; it names the file.
pub fn message(bytes: &[u8]) -> String {
    let message = match read(bytes) {
        Ok(volume) => panic!("read {:?}", volume.dims()),
        Err(error) => error.to_string(),
    };
    assert!(message.starts_with("memory: "), "{message}");
    message
}

pub fn values(volume: &Volume) -> Vec<f64> {
    let [nx, ny, nz] = volume.dims().map(i64::from);
    (0..nx * ny * nz)
        .map(|i| volume.value([i % nx, i / nx % ny, i / nx / ny]))
        .collect()
}

/// A NIfTI file, field by field.
#[derive(Clone)]
pub struct Nifti {
    pub two: bool,
    pub big: bool,
    pub header: Vec<u8>,
    pub voxels: Vec<u8>,
}

impl Nifti {
    /// Spacings 1, 2, 3 (no unit), no orientation, no scaling.
    pub fn new<T: Number>(two: bool, big: bool, datatype: i16, dims: &[i64], voxels: &[T]) -> Self {
        let mut file = Self {
            two,
            big,
            header: vec![0; if two { 544 } else { 352 }],
            voxels: all_bytes(voxels, big),
        };
        let size = if two { 540 } else { 348 };
        file.put(0, 0, i32::bytes(size, big));
        let magic: &[u8] = if two { b"n+2\0\r\n\x1a\n" } else { b"n+1\0" };
        file.put(344, 4, magic.to_vec());
        file.put(70, 12, datatype.bytes(big));
        file.dim(0, dims.len() as i64);
        for (i, &dim) in dims.iter().enumerate() {
            file.dim(i + 1, dim);
        }
        for i in 0..4 {
            file.float(76, 104, i, (i as f64).max(1.0));
        }
        if two {
            file.put(0, 168, 544i64.bytes(big));
        } else {
            file.float(108, 0, 0, 352.0);
        }
        file
    }

    /// Puts bytes at an offset of NIfTI-1 or NIfTI-2.
    pub fn put(&mut self, one: usize, two: usize, bytes: Vec<u8>) {
        let at = if self.two { two } else { one };
        self.header[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    pub fn dim(&mut self, index: usize, dim: i64) {
        let bytes = if self.two {
            dim.bytes(self.big)
        } else {
            (dim as i16).bytes(self.big)
        };
        self.put(40 + 2 * index, 16 + 8 * index, bytes);
    }

    pub fn float(&mut self, one: usize, two: usize, index: usize, value: f64) {
        let bytes = if self.two {
            value.bytes(self.big)
        } else {
            (value as f32).bytes(self.big)
        };
        self.put(one + 4 * index, two + 8 * index, bytes);
    }

    pub fn code(&mut self, one: usize, two: usize, code: i16) {
        let bytes = if self.two {
            i32::from(code).bytes(self.big)
        } else {
            code.bytes(self.big)
        };
        self.put(one, two, bytes);
    }

    pub fn scaling(&mut self, slope: f64, intercept: f64) {
        self.float(112, 176, 0, slope);
        self.float(116, 184, 0, intercept);
    }

    pub fn sform(&mut self, code: i16, rows: [[f64; 4]; 3]) {
        self.code(254, 348, code);
        for (i, value) in rows.as_flattened().iter().enumerate() {
            self.float(280, 400, i, *value);
        }
    }

    /// b, c, d, and whether the third axis is turned over.
    pub fn qform(&mut self, code: i16, bcd: [f64; 3], mirrored: bool) {
        self.code(252, 344, code);
        self.float(76, 104, 0, if mirrored { -1.0 } else { 1.0 });
        for (i, value) in bcd.into_iter().enumerate() {
            self.float(256, 352, i, value);
        }
    }

    pub fn bytes(&self) -> Vec<u8> {
        [&self.header[..], &self.voxels].concat()
    }
}

/// An NRRD file of these header lines (without the first) and data.
pub fn nrrd(lines: &[&str], data: &[u8]) -> Vec<u8> {
    let mut bytes = format!("NRRD0004\n{}\n\n", lines.join("\n")).into_bytes();
    bytes.extend(data);
    bytes
}
