//! Filters that turn what a data file holds into the plain bytes of voxels.

use std::io::{self, BufRead, Read};

use crate::reader::numbers::NumberType;

/// The longest number of a text file: a denormal f64 written out needs no more.
const TOKEN_BYTES_MAX: usize = 1100;

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

/// Numbers in decimal, apart by white space or commas; yields them in the machine's byte order.
pub(super) struct TextNumbers<R> {
    text: R,
    number: NumberType,
    token: Vec<u8>,
    ready: Vec<u8>,
    taken: usize,
}

impl<R: BufRead> TextNumbers<R> {
    pub fn new(text: R, number: NumberType) -> Self {
        Self {
            text,
            number,
            token: Vec::new(),
            ready: Vec::new(),
            taken: 0,
        }
    }

    /// Reads the next number into `ready`; leaves it empty at the end.
    fn next_number(&mut self) -> io::Result<()> {
        self.token.clear();
        loop {
            let buffer = self.text.fill_buf()?;
            let Some(&byte) = buffer.first() else { break };
            self.text.consume(1);
            if byte.is_ascii_whitespace() || byte == b',' {
                if !self.token.is_empty() {
                    break;
                }
            } else if self.token.len() == TOKEN_BYTES_MAX {
                return Err(invalid(format!(
                    "a number of more than {TOKEN_BYTES_MAX} characters"
                )));
            } else {
                self.token.push(byte);
            }
        }
        self.ready.clear();
        self.taken = 0;
        if self.token.is_empty() {
            return Ok(());
        }
        let token = String::from_utf8_lossy(&self.token);
        let number = parse(&token, self.number)
            .ok_or_else(|| invalid(format!("`{token}` is no {}", self.number.name())))?;
        self.ready.extend_from_slice(&number);
        Ok(())
    }
}

fn parse(token: &str, number: NumberType) -> Option<Vec<u8>> {
    // Some writers put `12.0` or `1e3` where an integer is meant.
    let integer = || {
        token.parse::<i128>().ok().or_else(|| {
            let value = token.parse::<f64>().ok()?;
            (value.fract() == 0.0 && value.abs() < 2f64.powi(53)).then_some(value as i128)
        })
    };
    macro_rules! bytes_of {
        ($integer:ty) => {
            <$integer>::try_from(integer()?)
                .ok()?
                .to_ne_bytes()
                .to_vec()
        };
    }
    Some(match number {
        NumberType::U8 => bytes_of!(u8),
        NumberType::I8 => bytes_of!(i8),
        NumberType::U16 => bytes_of!(u16),
        NumberType::I16 => bytes_of!(i16),
        NumberType::U32 => bytes_of!(u32),
        NumberType::I32 => bytes_of!(i32),
        NumberType::U64 => bytes_of!(u64),
        NumberType::I64 => bytes_of!(i64),
        NumberType::F32 => token.parse::<f32>().ok()?.to_ne_bytes().to_vec(),
        NumberType::F64 => token.parse::<f64>().ok()?.to_ne_bytes().to_vec(),
    })
}

impl<R: BufRead> Read for TextNumbers<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut written = 0;
        for byte in buffer {
            if self.taken == self.ready.len() {
                self.next_number()?;
            }
            let Some(&next) = self.ready.get(self.taken) else {
                break;
            };
            *byte = next;
            self.taken += 1;
            written += 1;
        }
        Ok(written)
    }
}

/// Pairs of hexadecimal digits, white space between them ignored.
pub(super) struct HexBytes<R>(pub R);

impl<R: BufRead> HexBytes<R> {
    fn digit(&mut self) -> io::Result<Option<u8>> {
        loop {
            let Some(&byte) = self.0.fill_buf()?.first() else {
                return Ok(None);
            };
            self.0.consume(1);
            if byte.is_ascii_whitespace() {
                continue;
            }
            return match char::from(byte).to_digit(16) {
                Some(digit) => Ok(Some(digit as u8)),
                None => Err(invalid(format!(
                    "`{}` is no hexadecimal digit",
                    char::from(byte).escape_default()
                ))),
            };
        }
    }
}

impl<R: BufRead> Read for HexBytes<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut written = 0;
        for byte in buffer {
            let Some(high) = self.digit()? else { break };
            let Some(low) = self.digit()? else { break };
            *byte = high << 4 | low;
            written += 1;
        }
        Ok(written)
    }
}
