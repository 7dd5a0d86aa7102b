use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

use flate2::bufread::GzDecoder;

use crate::VolumeError;

/// Deflate can't expand a byte to more than this many (258 bytes for 2 bits).
const DEFLATE_RATIO_MAX: u64 = 1032;

/// Large enough for sequential reads from a disk, small beside any volume.
const BUFFER_BYTES: usize = 256 << 10;

/// How much of a file's beginning [`Input::peek`] shows to readers.
const PEEK_BYTES: usize = 1024;

const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

/// The bytes of a volume file, wherever they come from, and what messages call them.
pub struct Input<'a> {
    path: PathBuf,
    stream: Box<dyn BufRead + 'a>,
    /// Upper bound of the bytes that follow; exact if `is_exact`.
    at_most: Option<u64>,
    is_exact: bool,
    /// Whether other files, named in this one, may be opened.
    has_siblings: bool,
}

impl Input<'static> {
    /// Opens a file.
    ///
    /// # Errors
    /// If it is missing, a folder, or can't be opened.
    pub fn open(path: &Path) -> Result<Self, VolumeError> {
        let error = |source| VolumeError::io(path, source);
        let metadata = std::fs::metadata(path).map_err(error)?;
        if metadata.is_dir() {
            return Err(VolumeError::Folder { path: path.into() });
        }
        let length = metadata.is_file().then_some(metadata.len());
        let file = File::open(path).map_err(error)?;
        Ok(Self {
            path: path.into(),
            stream: Box::new(BufReader::with_capacity(BUFFER_BYTES, file)),
            at_most: length,
            is_exact: length.is_some(),
            has_siblings: true,
        })
    }
}

impl<'a> Input<'a> {
    /// Bytes in memory; `name` is what messages call them. Other files they name aren't opened.
    pub fn from_bytes(name: &Path, bytes: &'a [u8]) -> Self {
        Self {
            path: name.into(),
            stream: Box::new(bytes),
            at_most: Some(bytes.len() as u64),
            is_exact: true,
            has_siblings: false,
        }
    }

    /// What messages call these bytes.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// An upper bound of the bytes that follow, if there is one.
    pub fn at_most(&self) -> Option<u64> {
        self.at_most
    }

    /// How many bytes follow, if that is known.
    pub fn exact_length(&self) -> Option<u64> {
        self.at_most.filter(|_| self.is_exact)
    }

    /// The first bytes (up to 1024), which stay to be read.
    ///
    /// # Errors
    /// If reading fails; damaged gzip content included.
    pub fn peek(&mut self) -> Result<Vec<u8>, VolumeError> {
        let mut first = Vec::new();
        self.stream
            .by_ref()
            .take(PEEK_BYTES as u64)
            .read_to_end(&mut first)
            .map_err(|source| VolumeError::decoding(&self.path, source))?;
        let rest = std::mem::replace(&mut self.stream, Box::new(io::empty()));
        self.stream = Box::new(Cursor::new(first.clone()).chain(rest));
        Ok(first)
    }

    /// The unpacked content from here on, whether or not it begins like a gzip stream.
    pub fn gunzip(self) -> Self {
        let decoder = GzipMembers(Some(GzDecoder::new(self.stream)));
        Self {
            stream: Box::new(BufReader::with_capacity(BUFFER_BYTES, decoder)),
            at_most: self
                .at_most
                .map(|packed| packed.saturating_mul(DEFLATE_RATIO_MAX)),
            is_exact: false,
            ..self
        }
    }

    /// The same, unpacked if it is a gzip stream.
    ///
    /// # Errors
    /// If reading fails.
    pub fn gunzip_if_packed(mut self) -> Result<Self, VolumeError> {
        let packed = self.peek()?.starts_with(&GZIP_MAGIC);
        Ok(if packed { self.gunzip() } else { self })
    }

    /// Opens a file that this one names, relative to its folder.
    ///
    /// # Errors
    /// If it is missing or not a regular file, or if this input is not a file.
    pub fn open_sibling(&self, name: &str) -> Result<Input<'static>, VolumeError> {
        let data = self.path.parent().unwrap_or(Path::new("")).join(name);
        let error = |source| VolumeError::DataFile {
            header: self.path.clone(),
            data: data.clone(),
            source,
        };
        if !self.has_siblings {
            return Err(error(io::Error::other("the header itself is not a file")));
        }
        // A device or a pipe could block for ever.
        if !std::fs::metadata(&data).map_err(error)?.is_file() {
            return Err(error(io::Error::other("not a regular file")));
        }
        Input::open(&data)
    }

    /// Leaves out the next bytes; fewer if the input ends before.
    ///
    /// # Errors
    /// If reading fails.
    pub fn skip(&mut self, bytes: u64) -> Result<(), VolumeError> {
        io::copy(&mut self.by_ref().take(bytes), &mut io::sink())
            .map(|_| ())
            .map_err(|source| VolumeError::decoding(&self.path, source))
    }

    /// The same input with its bytes passed through a filter that yields `at_most` bytes.
    pub(super) fn filtered<R: Read + 'a>(
        self,
        at_most: Option<u64>,
        filter: impl FnOnce(Box<dyn BufRead + 'a>) -> R,
    ) -> Self {
        Self {
            stream: Box::new(BufReader::with_capacity(BUFFER_BYTES, filter(self.stream))),
            at_most,
            is_exact: false,
            ..self
        }
    }

    fn count(&mut self, bytes: usize) {
        self.at_most = self.at_most.map(|left| left.saturating_sub(bytes as u64));
    }
}

impl Read for Input<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let bytes = self.stream.read(buffer)?;
        self.count(bytes);
        Ok(bytes)
    }
}

impl BufRead for Input<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.stream.fill_buf()
    }

    fn consume(&mut self, bytes: usize) {
        self.stream.consume(bytes);
        self.count(bytes);
    }
}

/// Unpacks gzip members up to the end or to something else, which gzip too passes over.
struct GzipMembers<R>(Option<GzDecoder<R>>);

impl<R: BufRead> Read for GzipMembers<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while let Some(decoder) = &mut self.0 {
            let bytes = decoder.read(buffer)?;
            if bytes > 0 || buffer.is_empty() {
                return Ok(bytes);
            }
            let mut rest = self.0.take().map(GzDecoder::into_inner);
            if let Some(rest) = &mut rest
                && rest.fill_buf()?.first() != GZIP_MAGIC.first()
            {
                break;
            }
            self.0 = rest.map(GzDecoder::new);
        }
        Ok(0)
    }
}
