//! Unpacking on a thread of its own, while the caller's puts the voxels into place.

use std::io::{self, Read};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Unpacked in pieces of this many bytes, which stay in the cores' caches.
const CHUNK_BYTES: usize = 256 << 10;

/// Pieces that may wait.
const CHUNKS_AHEAD: usize = 4;

/// What a reader yields, read ahead by a thread that ends when this is dropped.
pub(super) struct ReadAhead {
    chunks: Receiver<io::Result<Vec<u8>>>,
    spare: SyncSender<Vec<u8>>,
    current: Vec<u8>,
    at: usize,
}

impl ReadAhead {
    /// Starts the thread.
    ///
    /// # Errors
    /// If the system has no room for one.
    pub fn new(mut reader: impl Read + Send + 'static) -> io::Result<Self> {
        let (filled, chunks) = sync_channel(CHUNKS_AHEAD);
        let (spare, emptied) = sync_channel::<Vec<u8>>(CHUNKS_AHEAD + 2);
        std::thread::Builder::new()
            .name("unpack".into())
            .spawn(move || {
                loop {
                    let mut chunk = emptied.try_recv().unwrap_or_default();
                    chunk.resize(CHUNK_BYTES, 0);
                    let result = fill(&mut reader, &mut chunk).map(|count| {
                        chunk.truncate(count);
                        chunk
                    });
                    let ended = result
                        .as_ref()
                        .map_or(true, |chunk| chunk.len() < CHUNK_BYTES);
                    if filled.send(result).is_err() || ended {
                        break;
                    }
                }
            })?;
        Ok(Self {
            chunks,
            spare,
            current: Vec::new(),
            at: 0,
        })
    }
}

/// Fills the buffer; returns fewer bytes only at the end.
fn fill(reader: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut done = 0;
    while let Some(rest) = buffer.get_mut(done..).filter(|rest| !rest.is_empty()) {
        match reader.read(rest) {
            Ok(0) => break,
            Ok(count) => done += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(done)
}

impl Read for ReadAhead {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.at == self.current.len() {
            let used = std::mem::take(&mut self.current);
            self.at = 0;
            if used.capacity() > 0 {
                // Where there is no room for it, it is freed.
                let _ = self.spare.try_send(used);
            }
            match self.chunks.recv() {
                Ok(Ok(chunk)) if chunk.is_empty() => return Ok(0),
                Ok(Ok(chunk)) => self.current = chunk,
                Ok(Err(error)) => return Err(error),
                // The thread has ended after its last piece.
                Err(_) => return Ok(0),
            }
        }
        let rest = self.current.get(self.at..).unwrap_or_default();
        let count = rest.len().min(buffer.len());
        if let (Some(to), Some(from)) = (buffer.get_mut(..count), rest.get(..count)) {
            to.copy_from_slice(from);
        }
        self.at += count;
        Ok(count)
    }
}
