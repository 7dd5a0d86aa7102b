use std::fs;
use std::path::{Path, PathBuf};

use exr::prelude as openexr;
use exr::prelude::{ReadChannels, ReadLayers, WritableImage};

/// A picture: linear RGB, premultiplied by opacity, and opacity.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    width: u32,
    height: u32,
    pixels: Vec<[f32; 4]>,
}

/// Why an image could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The file could not be opened, read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a picture that can be read.
    #[error(
        "{}: not a readable picture: {reason}; expected an OpenEXR file with the channels R, G, B and, for opacity, A",
        path.display()
    )]
    Decode {
        /// The file.
        path: PathBuf,
        /// What the decoder said.
        reason: String,
    },
    /// The header claims a size that can't be right.
    #[error(
        "{}: the header claims {width} × {height} pixels: expected 1 to {} per side and a file of fitting length, not {file_bytes} bytes",
        path.display(),
        Image::MAX_SIDE
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Length of the file.
        file_bytes: u64,
    },
    /// The picture could not be encoded.
    #[error("{}: could not be written: {reason}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// What the encoder said.
        reason: String,
    },
}

impl Image {
    /// Most pixels per side that a file may have.
    pub const MAX_SIDE: usize = 32768;
    /// No compression of OpenEXR packs more pixels than this into a byte.
    const MAX_PIXELS_PER_BYTE: u64 = 4096;

    /// A picture of row-major pixels, top row first.
    ///
    /// # Panics
    /// If `pixels.len()` is not `width · height`, or that is 0.
    pub fn new(width: u32, height: u32, pixels: Vec<[f32; 4]>) -> Self {
        assert!(
            !pixels.is_empty() && pixels.len() == width as usize * height as usize,
            "one pixel per place"
        );
        Self {
            width,
            height,
            pixels,
        }
    }

    /// Pixels across.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Row-major, top row first.
    pub fn pixels(&self) -> &[[f32; 4]] {
        &self.pixels
    }

    /// Reads the first layer of an OpenEXR file that has R, G and B; without A it is opaque.
    /// Numbers of 16 and 32 bits are read; NaN and infinities are kept.
    ///
    /// # Errors
    /// If the file is missing, damaged, or no such picture.
    pub fn read_exr(path: &Path) -> Result<Self, ImageError> {
        let io = |source| ImageError::Io {
            path: path.into(),
            source,
        };
        let decode = |error: openexr::Error| match error {
            openexr::Error::Io(source) => ImageError::Io {
                path: path.into(),
                source,
            },
            error => ImageError::Decode {
                path: path.into(),
                reason: error.to_string(),
            },
        };
        let bytes = fs::read(path).map_err(io)?;

        // Sizes first: the decoder would allocate what the header claims.
        let meta = exr::meta::MetaData::read_from_buffered(bytes.as_slice(), false);
        for header in &meta.map_err(decode)?.headers {
            let size = header.layer_size;
            let pixels = size.width() as u64 * size.height() as u64;
            let sides = 1..=Self::MAX_SIDE;
            if !(sides.contains(&size.width()) && sides.contains(&size.height()))
                || pixels > bytes.len() as u64 * Self::MAX_PIXELS_PER_BYTE
            {
                return Err(ImageError::Size {
                    path: path.into(),
                    width: size.width(),
                    height: size.height(),
                    file_bytes: bytes.len() as u64,
                });
            }
        }

        struct Pixels {
            width: usize,
            pixels: Vec<[f32; 4]>,
        }
        let layer = openexr::read()
            .no_deep_data()
            .largest_resolution_level()
            .rgba_channels(
                |size, _| Pixels {
                    width: size.width(),
                    pixels: vec![[0.0; 4]; size.area()],
                },
                |image: &mut Pixels, at, (r, g, b, a): (f32, f32, f32, f32)| {
                    if let Some(pixel) = image.pixels.get_mut(at.x() + image.width * at.y()) {
                        *pixel = [r, g, b, a];
                    }
                },
            )
            .first_valid_layer()
            .all_attributes()
            .from_buffered(std::io::Cursor::new(bytes))
            .map_err(decode)?
            .layer_data;
        let (width, height) = (layer.size.width() as u32, layer.size.height() as u32);
        Ok(Self::new(width, height, layer.channel_data.pixels.pixels))
    }

    /// Writes an OpenEXR file with 32-bit float R, G, B, A, ZIP-compressed: beside its place as
    /// `.part` first, so that a file of this name is always whole.
    ///
    /// # Errors
    /// If the folder is missing or can't be written.
    pub fn write_exr(&self, path: &Path) -> Result<(), ImageError> {
        // A link stays a link: what it points to is replaced.
        let place = fs::canonicalize(path).unwrap_or_else(|_| path.into());
        let mut part = place.as_os_str().to_owned();
        part.push(".part");
        let part = PathBuf::from(part);
        let width = self.width as usize;
        let channels = openexr::SpecificChannels::rgba(|at: openexr::Vec2<usize>| {
            let [r, g, b, a] = self.pixels[at.x() + width * at.y()];
            (r, g, b, a)
        });
        let layer = openexr::Layer::new(
            (width, self.height as usize),
            openexr::LayerAttributes::default(),
            openexr::Encoding {
                compression: openexr::Compression::ZIP16,
                blocks: openexr::Blocks::ScanLines,
                line_order: openexr::LineOrder::Increasing,
            },
            channels,
        );
        let written = openexr::Image::from_layer(layer).write().to_file(&part);
        let placed = match written {
            Ok(()) => fs::rename(&part, &place).map_err(|source| ImageError::Io {
                path: path.into(),
                source,
            }),
            Err(openexr::Error::Io(source)) => Err(ImageError::Io {
                path: path.into(),
                source,
            }),
            Err(error) => Err(ImageError::Encode {
                path: path.into(),
                reason: error.to_string(),
            }),
        };
        if placed.is_err() {
            // Nothing more can be done about a leftover that can't be removed either.
            let _ = fs::remove_file(&part);
        }
        placed
    }
}
