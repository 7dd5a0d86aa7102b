//! Unpacking gzip on a thread of its own, while the caller's puts the voxels into place.

use std::io::{self, BufRead, Read};
use std::sync::mpsc::{Receiver, SendError, SyncSender, sync_channel};

use flate2::Crc;
use flate2::bufread::{DeflateDecoder, GzDecoder};

/// Unpacked in pieces of this many bytes, which stay in the cores' caches.
const CHUNK_BYTES: usize = 256 << 10;

/// Pieces that may wait.
const CHUNKS_AHEAD: usize = 4;

/// What the thread hands over.
enum Piece {
    Bytes(Vec<u8>),
    /// The end of a member: what its trailer says.
    End {
        check_sum: u32,
        length: u32,
    },
}

/// The members of a gzip stream, unpacked ahead by a thread that ends when this is dropped. Check
/// sums are compared on the caller's thread, which has less to do.
pub(super) struct ReadAhead {
    pieces: Receiver<io::Result<Piece>>,
    spare: SyncSender<Vec<u8>>,
    current: Vec<u8>,
    at: usize,
    check_sum: Crc,
}

impl ReadAhead {
    /// Starts the thread.
    ///
    /// # Errors
    /// If the system has no room for one.
    pub fn gunzip(packed: impl BufRead + Send + 'static) -> io::Result<Self> {
        let (filled, pieces) = sync_channel(CHUNKS_AHEAD);
        let (spare, emptied) = sync_channel::<Vec<u8>>(CHUNKS_AHEAD + 2);
        std::thread::Builder::new()
            .name("unpack".into())
            .spawn(move || {
                if let Err(error) = unpack(packed, &emptied, &filled) {
                    // Where nobody reads on, nobody needs to know.
                    let _ = filled.send(Err(error));
                }
            })?;
        Ok(Self {
            pieces,
            spare,
            current: Vec::new(),
            at: 0,
            check_sum: Crc::new(),
        })
    }
}

/// Unpacks member after member, up to the end or to something else, which gzip too passes over.
fn unpack(
    mut packed: impl BufRead,
    emptied: &Receiver<Vec<u8>>,
    filled: &SyncSender<io::Result<Piece>>,
) -> io::Result<()> {
    let gone = |_: SendError<_>| io::Error::from(io::ErrorKind::BrokenPipe);
    loop {
        // Its header is read at once.
        let mut member = GzDecoder::new(packed);
        if member.header().is_none() {
            member.read_exact(&mut [0])?;
            return Err(io::ErrorKind::InvalidData.into());
        }
        let mut stream = DeflateDecoder::new(member.into_inner());
        loop {
            let mut chunk = emptied.try_recv().unwrap_or_default();
            chunk.resize(CHUNK_BYTES, 0);
            let count = fill(&mut stream, &mut chunk)?;
            chunk.truncate(count);
            filled.send(Ok(Piece::Bytes(chunk))).map_err(gone)?;
            if count < CHUNK_BYTES {
                break;
            }
        }
        packed = stream.into_inner();
        let mut trailer = [0; 8];
        packed.read_exact(&mut trailer)?;
        let [a, b, c, d, length @ ..] = trailer;
        let end = Piece::End {
            check_sum: u32::from_le_bytes([a, b, c, d]),
            length: u32::from_le_bytes(length),
        };
        filled.send(Ok(end)).map_err(gone)?;
        if packed.fill_buf()?.first() != Some(&0x1f) {
            return Ok(());
        }
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

impl ReadAhead {
    /// What is left of the current piece; of the next one if nothing is. Empty at the end.
    fn rest(&mut self) -> io::Result<&[u8]> {
        while self.at == self.current.len() {
            let used = std::mem::take(&mut self.current);
            self.at = 0;
            if used.capacity() > 0 {
                // Where there is no room for it, it is freed.
                let _ = self.spare.try_send(used);
            }
            match self.pieces.recv() {
                Ok(Ok(Piece::Bytes(chunk))) => {
                    self.check_sum.update(&chunk);
                    self.current = chunk;
                }
                Ok(Ok(Piece::End { check_sum, length })) => {
                    if (self.check_sum.sum(), self.check_sum.amount()) != (check_sum, length) {
                        let error = "the check sum of its gzip stream does not match";
                        return Err(io::Error::new(io::ErrorKind::InvalidData, error));
                    }
                    self.check_sum.reset();
                }
                Ok(Err(error)) => return Err(error),
                // The thread has ended after its last piece.
                Err(_) => return Ok(&[]),
            }
        }
        Ok(self.current.get(self.at..).unwrap_or_default())
    }
}

impl Read for ReadAhead {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let rest = self.rest()?;
        let count = rest.len().min(buffer.len());
        if let (Some(to), Some(from)) = (buffer.get_mut(..count), rest.get(..count)) {
            to.copy_from_slice(from);
        }
        self.at += count;
        Ok(count)
    }
}

impl BufRead for ReadAhead {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.rest()
    }

    fn consume(&mut self, bytes: usize) {
        self.at = (self.at + bytes).min(self.current.len());
    }
}
