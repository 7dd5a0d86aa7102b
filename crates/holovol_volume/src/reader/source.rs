//! Bytes that can be read from any place, by several threads at once.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::sync::Arc;

/// An open file or bytes in memory.
#[derive(Clone, Debug)]
pub(super) enum Source<'a> {
    File(Arc<File>, u64),
    Owned(Arc<Vec<u8>>),
    Borrowed(&'a [u8]),
}

impl<'a> Source<'a> {
    /// Bytes in all; of a file, when it was opened.
    pub fn length(&self) -> u64 {
        match self {
            Self::File(_, length) => *length,
            Self::Owned(bytes) => bytes.len() as u64,
            Self::Borrowed(bytes) => bytes.len() as u64,
        }
    }

    /// Fills the buffer from an offset; returns fewer bytes only at the end.
    pub fn read_at(&self, offset: u64, buffer: &mut [u8]) -> io::Result<usize> {
        let bytes: &[u8] = match self {
            Self::File(file, _) => return read_file_at(file, offset, buffer),
            Self::Owned(bytes) => bytes,
            Self::Borrowed(bytes) => bytes,
        };
        let start = usize::try_from(offset).unwrap_or(usize::MAX);
        let rest = bytes.get(start..).unwrap_or_default();
        let count = rest.len().min(buffer.len());
        if let (Some(to), Some(from)) = (buffer.get_mut(..count), rest.get(..count)) {
            to.copy_from_slice(from);
        }
        Ok(count)
    }

    /// Bytes from an offset on, at most `length`, in memory that grows with what arrives.
    pub fn read_vec(&self, offset: u64, length: u64) -> io::Result<Vec<u8>> {
        let there = self.length().saturating_sub(offset);
        let mut bytes = vec![0; usize::try_from(there.min(length)).unwrap_or(usize::MAX)];
        let count = self.read_at(offset, &mut bytes)?;
        bytes.truncate(count);
        Ok(bytes)
    }

    pub fn cursor(&self, at: u64) -> SourceCursor<'a> {
        SourceCursor {
            source: self.clone(),
            at,
        }
    }
}

#[cfg(unix)]
fn read_some_at(file: &File, offset: u64, buffer: &mut [u8]) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, offset)
}

#[cfg(windows)]
fn read_some_at(file: &File, offset: u64, buffer: &mut [u8]) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, buffer, offset)
}

fn read_file_at(file: &File, mut offset: u64, mut buffer: &mut [u8]) -> io::Result<usize> {
    let mut done = 0;
    while !buffer.is_empty() {
        match read_some_at(file, offset, buffer) {
            Ok(0) => break,
            Ok(count) => {
                done += count;
                offset += count as u64;
                buffer = buffer.get_mut(count..).unwrap_or_default();
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(done)
}

/// A place in a [`Source`], for what wants [`Read`] and [`Seek`].
#[derive(Clone, Debug)]
pub(super) struct SourceCursor<'a> {
    source: Source<'a>,
    at: u64,
}

impl Read for SourceCursor<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.source.read_at(self.at, buffer)?;
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for SourceCursor<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.source.length().checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = at.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(self.at)
    }
}
