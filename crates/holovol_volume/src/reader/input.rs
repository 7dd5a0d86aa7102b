use std::fs::{File, Metadata};
use std::io::{self, BufRead, BufReader, Cursor, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use flate2::bufread::GzDecoder;

use super::source::Source;
use super::threaded::ReadAhead;
use crate::VolumeError;

/// Deflate can't expand a byte to more than this many (258 bytes for 2 bits).
pub(super) const DEFLATE_RATIO_MAX: u64 = 1032;

/// What is unpacked for reading from any place stays in memory up to here.
const UNPACKED_IN_MEMORY: u64 = 2 << 20;

/// Unpacked files beyond this are refused.
const UNPACKED_MAX: u64 = 4 << 30;

/// Memory for what arrives begins with this.
const FIRST_ROOM: usize = 64 << 10;

/// Large enough for sequential reads from a disk, small beside any volume.
const BUFFER_BYTES: usize = 256 << 10;

/// Below this a thread would cost more than it saves.
const READ_AHEAD_BYTES_MIN: u64 = 128 << 10;

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
    /// The whole content for random access, as long as nothing has been read or unpacked.
    source: Option<Source<'a>>,
    /// The file's state when it was opened.
    stamp: Option<Stamp>,
}

/// What changes when a file is written to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Stamp {
    pub length: u64,
    modified: Option<SystemTime>,
}

impl Stamp {
    pub fn of(metadata: &Metadata) -> Self {
        Self {
            length: metadata.len(),
            modified: metadata.modified().ok(),
        }
    }

    /// Whether what now goes by this path is still the file that the stamp is of.
    ///
    /// # Errors
    /// If it isn't, or is gone.
    pub fn check(&self, path: &Path) -> Result<(), VolumeError> {
        match std::fs::metadata(path) {
            Ok(now) if Self::of(&now) == *self => Ok(()),
            _ => Err(VolumeError::Changed { path: path.into() }),
        }
    }
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
        let file = Arc::new(File::open(path).map_err(error)?);
        Ok(Self {
            path: path.into(),
            stream: Box::new(BufReader::with_capacity(BUFFER_BYTES, file.clone())),
            at_most: length,
            is_exact: length.is_some(),
            has_siblings: true,
            source: length.map(|length| Source::File(file, length)),
            stamp: length.map(|_| Stamp::of(&metadata)),
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
            source: Some(Source::Borrowed(bytes)),
            stamp: None,
        }
    }

    /// What a reader makes of a file, `at_most` bytes.
    pub(super) fn from_reader(name: &Path, reader: impl Read + 'a, at_most: u64) -> Self {
        Self {
            path: name.into(),
            stream: Box::new(BufReader::with_capacity(BUFFER_BYTES, reader)),
            at_most: Some(at_most),
            is_exact: false,
            has_siblings: false,
            source: None,
            stamp: None,
        }
    }

    /// The whole content, to be read from any place. What is packed or piped is unpacked first:
    /// into memory if it is small, else into a file without a name in the system's folder for
    /// such, so that a small file can't fill the memory.
    pub(super) fn into_source(mut self) -> Result<Source<'a>, VolumeError> {
        if let Some(source) = self.source.take() {
            return Ok(source);
        }
        let error = |path: &Path, source| VolumeError::decoding(path, source);
        let bytes = read_at_most(&mut self.stream, UNPACKED_IN_MEMORY)
            .map_err(|source| error(&self.path, source))?;
        if (bytes.len() as u64) < UNPACKED_IN_MEMORY {
            return Ok(Source::Owned(Arc::new(bytes)));
        }
        let path = std::env::temp_dir();
        let mut file = tempfile::tempfile().map_err(|source| VolumeError::io(&path, source))?;
        file.write_all(&bytes)
            .map_err(|source| VolumeError::io(&path, source))?;
        drop(bytes);
        let mut chunk = vec![0; BUFFER_BYTES];
        let mut length = UNPACKED_IN_MEMORY;
        loop {
            let count = self.stream.read(&mut chunk);
            let count = match count {
                Ok(0) => break,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                other => other.map_err(|source| error(&self.path, source))?,
            };
            length += count as u64;
            if length > UNPACKED_MAX {
                return Err(VolumeError::TooLarge {
                    path: self.path,
                    bytes: length,
                    limit: format!("the {UNPACKED_MAX} that may be unpacked"),
                });
            }
            file.write_all(chunk.get(..count).unwrap_or_default())
                .map_err(|source| VolumeError::io(&path, source))?;
        }
        Ok(Source::File(Arc::new(file), length))
    }

    /// The content from the current place on for random access, where that needs no copy.
    pub(super) fn direct(&self) -> Option<(Source<'a>, u64)> {
        let source = self.source.clone()?;
        let at = source.length().checked_sub(self.exact_length()?)?;
        Some((source, at))
    }

    /// Goes on at an offset of its source, up to which all has been read directly.
    pub(super) fn pass(&mut self, source: &Source<'a>, at: u64) {
        self.at_most = Some(source.length().saturating_sub(at));
        self.stream = Box::new(BufReader::with_capacity(BUFFER_BYTES, source.cursor(at)));
    }

    /// Whether the file is still as it was when it was opened.
    ///
    /// # Errors
    /// If it isn't.
    pub(super) fn check_unchanged(&self) -> Result<(), VolumeError> {
        match &self.stamp {
            Some(stamp) => stamp.check(&self.path),
            None => Ok(()),
        }
    }

    /// The file's state when it was opened; `None` if it is none that stays, such as a pipe.
    pub(super) fn stamp(&self) -> Option<Stamp> {
        self.stamp.clone()
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
        let stream = match self.read_ahead() {
            Some(ahead) => Box::new(ahead) as Box<dyn BufRead>,
            None => {
                let decoder = GzipMembers(Some(GzDecoder::new(self.stream)));
                Box::new(BufReader::with_capacity(BUFFER_BYTES, decoder))
            }
        };
        Self {
            stream,
            at_most: self
                .at_most
                .map(|packed| packed.saturating_mul(DEFLATE_RATIO_MAX)),
            is_exact: false,
            source: None,
            ..self
        }
    }

    /// Large files are unpacked on a thread of their own.
    fn read_ahead(&self) -> Option<ReadAhead> {
        let (source, at) = self.direct()?;
        let Source::File(file, length) = source else {
            return None;
        };
        if length < READ_AHEAD_BYTES_MIN {
            return None;
        }
        let packed = Source::File(file, length).cursor(at);
        let packed = BufReader::with_capacity(BUFFER_BYTES, packed);
        // Without a thread it goes, too.
        ReadAhead::gunzip(packed).ok()
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

    /// The contents of several files that this one names, one after the other: of each `bytes`
    /// after the first `skip`.
    ///
    /// # Errors
    /// If one is missing or not a regular file, or if this input is not a file.
    pub(super) fn open_siblings(
        &self,
        names: Vec<String>,
        skip: u64,
        bytes: u64,
    ) -> Result<Input<'static>, VolumeError> {
        let mut available = 0u64;
        for name in &names {
            let file = self.open_sibling(name)?;
            let length = file.exact_length().unwrap_or(0).saturating_sub(skip);
            available = available.saturating_add(length.min(bytes));
        }
        let folder = self.path.parent().unwrap_or(Path::new("")).to_path_buf();
        let files = names
            .into_iter()
            .map(move |name| -> io::Result<io::Take<File>> {
                let mut file = File::open(folder.join(name))?;
                file.seek(io::SeekFrom::Start(skip))?;
                Ok(file.take(bytes))
            });
        let files = OneByOne {
            files,
            current: None,
        };
        Ok(Input {
            path: self.path.clone(),
            stream: Box::new(BufReader::with_capacity(BUFFER_BYTES, files)),
            at_most: Some(available),
            is_exact: false,
            has_siblings: false,
            source: None,
            stamp: None,
        })
    }

    /// Entry number `entry` of every `count` blocks of `block` bytes.
    pub(super) fn entry_along_axis(self, block: u64, count: u64, entry: u64) -> Self {
        let at_most = self.at_most;
        self.filtered(at_most, |bytes| {
            EntryAlongAxis::new(bytes, block, count, entry)
        })
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
            source: None,
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

/// Reads to the end, but no more than `at_most` bytes, into memory that doubles with what arrives
/// and never exceeds `at_most`.
pub(super) fn read_at_most(mut reader: impl Read, at_most: u64) -> io::Result<Vec<u8>> {
    let at_most = usize::try_from(at_most).unwrap_or(usize::MAX);
    let mut bytes: Vec<u8> = Vec::new();
    loop {
        let room = bytes.len().max(FIRST_ROOM).min(at_most - bytes.len());
        if room == 0 {
            return Ok(bytes);
        }
        bytes
            .try_reserve_exact(room)
            .map_err(|_| io::ErrorKind::OutOfMemory)?;
        let read = reader.by_ref().take(room as u64).read_to_end(&mut bytes)?;
        if read < room {
            return Ok(bytes);
        }
    }
}

/// Files that are opened one after the other.
struct OneByOne<I> {
    files: I,
    current: Option<io::Take<File>>,
}

impl<I: Iterator<Item = io::Result<io::Take<File>>>> Read for OneByOne<I> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            if let Some(file) = &mut self.current {
                let bytes = file.read(buffer)?;
                if bytes > 0 || buffer.is_empty() {
                    return Ok(bytes);
                }
                if file.limit() > 0 {
                    // A short file would shift all that follow.
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
            }
            match self.files.next() {
                Some(file) => self.current = Some(file?),
                None => return Ok(0),
            }
        }
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

/// One entry along an axis: of every `count` blocks of bytes one.
struct EntryAlongAxis<R> {
    bytes: R,
    kept: u64,
    skipped: u64,
    left: u64,
    to_skip: u64,
}

impl<R: Read> EntryAlongAxis<R> {
    fn new(bytes: R, block: u64, count: u64, entry: u64) -> Self {
        Self {
            bytes,
            kept: block,
            skipped: block.saturating_mul(count.saturating_sub(1)),
            left: block,
            to_skip: block.saturating_mul(entry),
        }
    }
}

impl<R: Read> Read for EntryAlongAxis<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.left == 0 {
            self.to_skip = self.skipped;
            self.left = self.kept;
        }
        while self.to_skip > 0 {
            let skipped = io::copy(&mut self.bytes.by_ref().take(self.to_skip), &mut io::sink())?;
            if skipped == 0 {
                return Ok(0);
            }
            self.to_skip -= skipped;
        }
        let length = (buffer.len() as u64).min(self.left) as usize;
        let bytes = self
            .bytes
            .read(buffer.get_mut(..length).unwrap_or_default())?;
        self.left -= bytes as u64;
        Ok(bytes)
    }
}
