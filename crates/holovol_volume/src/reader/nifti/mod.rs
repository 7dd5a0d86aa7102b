//! NIfTI-1 and NIfTI-2, single files (`.nii`, `.nii.gz`) and pairs (`.hdr` and `.img`), either
//! byte order; Analyze 7.5 pairs.
//!
//! Of a 4-D file the first volume is read, or the one that was chosen. The s-form places the voxels if it is set and sound,
//! else the q-form, else the spacings alone.

mod header;

use std::io::Read;
use std::path::Path;

use super::decode::{self, Decoded, Layout};
use super::numbers::NumberType;
use super::options::Content;
use super::{Input, Progress, ReadOptions, VolumeReader, select};
use crate::{SourceFormat, Volume, VolumeError};
use header::{Header, Storage, Version};

/// Reads NIfTI-1 and NIfTI-2.
#[derive(Clone, Copy, Debug)]
pub struct NiftiReader;

impl VolumeReader for NiftiReader {
    fn name(&self) -> &'static str {
        "NIfTI"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &[".nii", ".nii.gz", ".hdr", ".img"]
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
        if let Some(header) = header_of_image(&mut input)? {
            input = header;
        }
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
        let mut data = match header.storage() {
            Storage::Single => {
                input.skip(header.voxel_offset()? - version.header_bytes())?;
                input
            }
            Storage::Pair | Storage::Analyze => {
                let mut data = image_of_header(&input)?;
                data.skip(header.voxel_offset()?)?;
                data
            }
        };
        let volume = select::entry(options, &path, volumes, "volume", "volume")?;
        let volume_bytes = layout.voxel_bytes().unwrap_or(u64::MAX);
        data.skip(volume_bytes.saturating_mul(volume))?;
        let Decoded {
            voxels,
            notices: lost,
            rounded,
        } = decode::read_voxels(&mut data, &layout, options, progress)?;
        notices.extend(lost);
        if volumes > 1 {
            notices.push(select::notice(volumes, "volumes", volume));
        } else {
            notices.extend(decode::check_end(&mut data)?);
        }

        let mut volume = Volume::new(voxels, layout.dims, slope, intercept, geometry)?
            .with_rounded(rounded)
            .with_source_format(SourceFormat {
                name: header.format(),
                numbers: layout.number.name(),
            });
        if let Some(window) = header.window() {
            volume = volume.with_header_window(window);
        }
        if header.is_labels() {
            volume = volume.with_labels(Vec::new());
        }
        Ok(notices.into_iter().fold(volume, Volume::with_notice))
    }

    fn contents(
        &self,
        mut input: Input<'_>,
        _options: &ReadOptions,
    ) -> Result<Vec<Content>, VolumeError> {
        if let Some(header) = header_of_image(&mut input)? {
            input = header;
        }
        let path = input.path().to_path_buf();
        let start = input.peek()?;
        let Some((version, big_endian)) = Version::detect(&start) else {
            return Ok(Vec::new());
        };
        let header = Header::new(&start, version, big_endian, &path)?;
        let volumes = header.volume_count();
        Ok(if volumes > 1 {
            select::contents(volumes, "volume")
        } else {
            Vec::new()
        })
    }
}

/// The header of a pair, where its image was named.
fn header_of_image<'a>(input: &mut Input<'a>) -> Result<Option<Input<'a>>, VolumeError> {
    let name = input.path().to_string_lossy().into_owned();
    let stem = [".img", ".img.gz"].iter().find_map(|end| {
        name.len()
            .checked_sub(end.len())
            .filter(|_| name.to_lowercase().ends_with(end))
    });
    let Some(stem) = stem.and_then(|length| name.get(..length)) else {
        return Ok(None);
    };
    if Version::detect(&input.peek()?).is_some() {
        return Ok(None);
    }
    open_first(input, stem, &[".hdr", ".HDR", ".hdr.gz"]).map(Some)
}

/// The image of a pair, unpacked if need be.
fn image_of_header(input: &Input<'_>) -> Result<Input<'static>, VolumeError> {
    let name = input.path().to_string_lossy().into_owned();
    let stem = [".hdr", ".hdr.gz"]
        .iter()
        .find_map(|end| {
            name.len()
                .checked_sub(end.len())
                .filter(|_| name.to_lowercase().ends_with(end))
        })
        .and_then(|length| name.get(..length))
        .unwrap_or(&name);
    open_first(input, stem, &[".img", ".IMG", ".img.gz"])?.gunzip_if_packed()
}

/// Opens the first file that is there; the first one's error if none is.
fn open_first(input: &Input<'_>, stem: &str, ends: &[&str]) -> Result<Input<'static>, VolumeError> {
    let stem = Path::new(stem)
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    let mut first = None;
    for end in ends {
        match input.open_sibling(&format!("{stem}{end}")) {
            Ok(file) => return file.gunzip_if_packed(),
            Err(error) => first = first.or(Some(error)),
        }
    }
    Err(first.unwrap_or_else(|| VolumeError::io(input.path(), std::io::ErrorKind::NotFound.into())))
}

fn number_type(header: &Header<'_>, path: &Path) -> Result<NumberType, VolumeError> {
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
