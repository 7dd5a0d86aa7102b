//! NIfTI-1 and NIfTI-2, single files (`.nii`, `.nii.gz`), either byte order.
//!
//! Of a 4-D file the first volume is read. The s-form places the voxels if it is set and sound,
//! else the q-form, else the spacings alone.

mod header;

use std::io::Read;

use super::decode::{self, Decoded, Layout};
use super::numbers::NumberType;
use super::{Input, Progress, ReadOptions, VolumeReader};
use crate::{SourceFormat, Volume, VolumeError};
use header::{Header, Version};

/// Reads NIfTI-1 and NIfTI-2.
#[derive(Clone, Copy, Debug)]
pub struct NiftiReader;

impl VolumeReader for NiftiReader {
    fn name(&self) -> &'static str {
        "NIfTI"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &[".nii", ".nii.gz"]
    }

    fn recognises(&self, first_bytes: &[u8]) -> bool {
        Version::detect(first_bytes).is_some()
    }

    fn read(
        &self,
        mut input: Input<'_>,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError> {
        let path = input.path().to_path_buf();
        let truncated = || VolumeError::TruncatedHeader {
            path: path.clone(),
            format: "NIfTI",
        };
        let mut start = Vec::new();
        (&mut input)
            .take(4)
            .read_to_end(&mut start)
            .map_err(|source| VolumeError::decoding(&path, source))?;
        if start.len() < 4 {
            return Err(truncated());
        }
        let (version, big_endian) = Version::detect(&start).ok_or_else(|| VolumeError::Field {
            path: path.clone(),
            format: "NIfTI",
            field: "sizeof_hdr".into(),
            found: format!("bytes {start:02x?}"),
            expected: "348 (NIfTI-1) or 540 (NIfTI-2): this is no NIfTI file, or it is damaged"
                .into(),
        })?;
        (&mut input)
            .take(version.header_bytes() - 4)
            .read_to_end(&mut start)
            .map_err(|source| VolumeError::decoding(&path, source))?;
        if (start.len() as u64) < version.header_bytes() {
            return Err(truncated());
        }
        let header = Header::new(&start, version, big_endian, &path)?;

        let mut notices = Vec::new();
        let layout = Layout {
            number: number_type(&header, &path)?,
            big_endian,
            dims: header.dims()?,
        };
        let (slope, intercept) = header.scaling(&mut notices);
        let geometry = header.geometry(&mut notices);
        let volumes = header.volume_count();
        input.skip(header.voxel_offset()? - version.header_bytes())?;
        let Decoded {
            voxels,
            notices: lost,
        } = decode::read_voxels(&mut input, &layout, options, progress)?;
        notices.extend(lost);
        if volumes > 1 {
            notices.push(format!("the file has {volumes} volumes: this is the first"));
        } else {
            notices.extend(decode::check_end(&mut input)?);
        }

        let mut volume = Volume::new(voxels, layout.dims, slope, intercept, geometry)?
            .with_source_format(SourceFormat {
                name: version.name(),
                numbers: layout.number.name(),
            });
        if let Some(window) = header.window() {
            volume = volume.with_header_window(window);
        }
        Ok(notices.into_iter().fold(volume, Volume::with_notice))
    }
}

fn number_type(header: &Header<'_>, path: &std::path::Path) -> Result<NumberType, VolumeError> {
    let code = header.datatype();
    let unsupported = |name: &str, way_out: &str| {
        Err(VolumeError::Unsupported {
            path: path.into(),
            what: format!("`datatype` {code} ({name}) is no single real number per voxel"),
            way_out: way_out.into(),
        })
    };
    const MAGNITUDE: &str = "save its magnitude (or real part) as float32";
    const CHANNEL: &str = "save one channel or the luminance as uint8";
    Ok(match code {
        2 => NumberType::U8,
        4 => NumberType::I16,
        8 => NumberType::I32,
        16 => NumberType::F32,
        64 => NumberType::F64,
        256 => NumberType::I8,
        512 => NumberType::U16,
        768 => NumberType::U32,
        1024 => NumberType::I64,
        1280 => NumberType::U64,
        1 => return unsupported("1-bit", "save it as uint8"),
        32 => return unsupported("complex64", MAGNITUDE),
        1792 => return unsupported("complex128", MAGNITUDE),
        2048 => return unsupported("complex256", MAGNITUDE),
        128 => return unsupported("RGB24", CHANNEL),
        2304 => return unsupported("RGBA32", CHANNEL),
        1536 => return unsupported("float128", "save it as float64 or float32"),
        _ => {
            return Err(VolumeError::Field {
                path: path.into(),
                format: "NIfTI",
                field: "datatype".into(),
                found: code.to_string(),
                expected: "2, 4, 8, 16, 64, 256, 512, 768, 1024 or 1280 (integers and floats)"
                    .into(),
            });
        }
    })
}
