//! The tree of elements in a DICOM file, as far as it is wanted here.
//!
//! Only the tags of [`wanted`] are kept, none of which says who the patient is: names and
//! identifiers are passed over unread, so that no message can hold them. (`dicom-object`, the
//! maintained parser, keeps every element, and reserves the length that an element claims.)

use super::tags::{self, Tag, wanted};

/// Deeper nesting than this is damage.
const DEPTH_MAX: usize = 16;

/// What describes a frame has at least this many bytes, where there are more than so many items,
/// those in others included.
const SMALL_ITEM_BYTES: usize = 64;
const SMALL_ITEMS_MAX: usize = 4096;

/// A list of numbers is no longer than this as text.
pub(super) const DECIMALS_BYTES_MAX: usize = 256 << 10;

const UNDEFINED: u32 = u32::MAX;

/// Where an element's value is.
#[derive(Clone, Debug)]
enum Value<'a> {
    Bytes(&'a [u8]),
    Items(Vec<Dataset<'a>>),
}

/// The wanted elements of a data set or of a sequence's item.
#[derive(Clone, Debug, Default)]
pub(super) struct Dataset<'a> {
    elements: Vec<(Tag, Value<'a>)>,
    big_endian: bool,
}

/// Where the pixel data is in the file, and how it is wrapped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PixelData {
    pub tag: Tag,
    /// Of the first byte after the element's header.
    pub offset: u64,
    /// `None` if it is cut into fragments.
    pub length: Option<u64>,
}

/// Why a data set can't be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Failure {
    /// The bytes end before the pixel data comes.
    Short,
    /// Not DICOM, or damaged: what is wrong.
    Damaged(&'static str),
}

/// How elements are written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Encoding {
    pub explicit_vr: bool,
    pub big_endian: bool,
}

impl<'a> Dataset<'a> {
    /// Reads elements from `start` up to the pixel data.
    ///
    /// `complete`: whether `bytes` are all that there are; if not, their end is [`Failure::Short`].
    pub fn parse(
        bytes: &'a [u8],
        start: usize,
        encoding: Encoding,
        complete: bool,
    ) -> Result<(Self, Option<PixelData>), Failure> {
        let mut parser = Parser {
            bytes,
            at: start,
            encoding,
            items: 0,
        };
        let mut dataset = Dataset {
            elements: Vec::new(),
            big_endian: encoding.big_endian,
        };
        while parser.at < bytes.len() {
            let element = parser.element_header()?;
            if matches!(
                element.tag,
                tags::PIXEL_DATA | tags::FLOAT_PIXEL_DATA | tags::DOUBLE_PIXEL_DATA
            ) {
                let pixels = PixelData {
                    tag: element.tag,
                    offset: parser.at as u64,
                    length: (element.length != UNDEFINED).then_some(element.length.into()),
                };
                return Ok((dataset, Some(pixels)));
            }
            parser.value(&element, 0, &mut dataset)?;
        }
        if complete {
            Ok((dataset, None))
        } else {
            Err(Failure::Short)
        }
    }

    /// Reads the file meta group; returns the transfer syntax and where the data set begins.
    pub fn parse_meta(bytes: &[u8], start: usize) -> Result<(Option<String>, usize), Failure> {
        let mut parser = Parser {
            bytes,
            at: start,
            encoding: Encoding {
                explicit_vr: true,
                big_endian: false,
            },
            items: 0,
        };
        let mut meta = Dataset::default();
        while bytes
            .get(parser.at..)
            .unwrap_or_default()
            .starts_with(&[2, 0])
        {
            let element = parser.element_header()?;
            parser.value(&element, 0, &mut meta)?;
        }
        Ok((meta.text(tags::TRANSFER_SYNTAX), parser.at))
    }

    pub fn bytes(&self, tag: Tag) -> Option<&'a [u8]> {
        self.elements.iter().find_map(|(t, value)| match value {
            Value::Bytes(bytes) if *t == tag => Some(*bytes),
            _ => None,
        })
    }

    /// The items of a sequence; none if it is absent.
    pub fn items(&self, tag: Tag) -> &[Dataset<'a>] {
        let found = self.elements.iter().find_map(|(t, value)| match value {
            Value::Items(items) if *t == tag => Some(items.as_slice()),
            _ => None,
        });
        found.unwrap_or_default()
    }

    /// The first item of a sequence.
    pub fn item(&self, tag: Tag) -> Option<&Dataset<'a>> {
        self.items(tag).first()
    }

    /// A text value without its padding; `None` if it is absent or empty.
    pub fn text(&self, tag: Tag) -> Option<String> {
        let text = String::from_utf8_lossy(self.bytes(tag)?).into_owned();
        let text = text.trim_matches(|c: char| c.is_whitespace() || c == '\0');
        (!text.is_empty()).then(|| text.to_owned())
    }

    /// Decimal or integer strings; `Err` holds a text that is none, or longer than
    /// [`DECIMALS_BYTES_MAX`].
    pub fn decimals(&self, tag: Tag) -> Result<Option<Vec<f64>>, String> {
        let Some(text) = self.text(tag) else {
            return Ok(None);
        };
        if text.len() > DECIMALS_BYTES_MAX {
            return Err(text);
        }
        let number = |part: &str| {
            let part = part.trim_matches(|c: char| c.is_whitespace() || c == '\0');
            part.parse::<f64>().ok().filter(|number| number.is_finite())
        };
        text.split('\\')
            .map(number)
            .collect::<Option<Vec<_>>>()
            .map(Some)
            .ok_or(text)
    }

    /// An unsigned 16-bit number.
    pub fn unsigned(&self, tag: Tag) -> Option<u16> {
        let bytes = *self.bytes(tag)?.first_chunk()?;
        Some(if self.big_endian {
            u16::from_be_bytes(bytes)
        } else {
            u16::from_le_bytes(bytes)
        })
    }

    pub fn unsigned_32(&self, tag: Tag) -> Option<u32> {
        let bytes = *self.bytes(tag)?.first_chunk()?;
        Some(if self.big_endian {
            u32::from_be_bytes(bytes)
        } else {
            u32::from_le_bytes(bytes)
        })
    }

    pub fn double(&self, tag: Tag) -> Option<f64> {
        let bytes = *self.bytes(tag)?.first_chunk()?;
        Some(if self.big_endian {
            f64::from_be_bytes(bytes)
        } else {
            f64::from_le_bytes(bytes)
        })
    }
}

/// Most lists here have one entry, for which [`Vec::push`] would make room for four.
fn push_tightly<T>(list: &mut Vec<T>, entry: T) {
    if list.is_empty() {
        list.reserve_exact(1);
    }
    list.push(entry);
}

struct Element {
    tag: Tag,
    length: u32,
    is_sequence: bool,
    /// `UN`: what is inside is in implicit VR.
    is_unknown: bool,
}

struct Parser<'a> {
    bytes: &'a [u8],
    at: usize,
    encoding: Encoding,
    items: usize,
}

impl<'a> Parser<'a> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], Failure> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let bytes = *rest.first_chunk::<N>().ok_or(Failure::Short)?;
        self.at += N;
        Ok(bytes)
    }

    fn u16(&mut self) -> Result<u16, Failure> {
        let bytes = self.take()?;
        Ok(if self.encoding.big_endian {
            u16::from_be_bytes(bytes)
        } else {
            u16::from_le_bytes(bytes)
        })
    }

    fn u32(&mut self) -> Result<u32, Failure> {
        let bytes = self.take()?;
        Ok(if self.encoding.big_endian {
            u32::from_be_bytes(bytes)
        } else {
            u32::from_le_bytes(bytes)
        })
    }

    fn tag(&mut self) -> Result<Tag, Failure> {
        let group = self.u16()?;
        let element = self.u16()?;
        Ok(Tag::from(group) << 16 | Tag::from(element))
    }

    fn element_header(&mut self) -> Result<Element, Failure> {
        let tag = self.tag()?;
        // Items and delimiters have no VR.
        if !self.encoding.explicit_vr || tag >> 16 == 0xfffe {
            let length = self.u32()?;
            return Ok(Element {
                tag,
                length,
                is_sequence: length == UNDEFINED || tags::is_sequence(tag),
                is_unknown: false,
            });
        }
        let vr = self.take::<2>()?;
        if !vr.iter().all(u8::is_ascii_uppercase) {
            return Err(Failure::Damaged("an element has no value representation"));
        }
        let long = matches!(
            &vr,
            b"OB"
                | b"OD"
                | b"OF"
                | b"OL"
                | b"OV"
                | b"OW"
                | b"SQ"
                | b"SV"
                | b"UC"
                | b"UN"
                | b"UR"
                | b"UT"
                | b"UV"
        );
        let length = if long {
            self.u16()?;
            self.u32()?
        } else {
            self.u16()?.into()
        };
        Ok(Element {
            tag,
            length,
            is_sequence: &vr == b"SQ" || length == UNDEFINED,
            is_unknown: &vr == b"UN",
        })
    }

    /// Passes over a value, keeping it if it is wanted.
    fn value(
        &mut self,
        element: &Element,
        depth: usize,
        dataset: &mut Dataset<'a>,
    ) -> Result<(), Failure> {
        let keep = wanted(element.tag);
        if element.is_sequence && (keep || element.length == UNDEFINED) {
            let outer = self.encoding;
            if element.is_unknown {
                self.encoding = Encoding {
                    explicit_vr: false,
                    big_endian: false,
                };
            }
            let items = self.sequence(element.length, keep, depth + 1)?;
            self.encoding = outer;
            if keep && !dataset.elements.iter().any(|(tag, _)| *tag == element.tag) {
                push_tightly(&mut dataset.elements, (element.tag, Value::Items(items)));
            }
            return Ok(());
        }
        let end = self.end(element.length)?;
        // A second one is damage; keeping it would let small files fill the memory.
        if keep && !dataset.elements.iter().any(|(tag, _)| *tag == element.tag) {
            let value = self.bytes.get(self.at..end).unwrap_or_default();
            push_tightly(&mut dataset.elements, (element.tag, Value::Bytes(value)));
        }
        self.at = end;
        Ok(())
    }

    fn end(&self, length: u32) -> Result<usize, Failure> {
        let end = self.at.checked_add(length as usize);
        end.filter(|&end| end <= self.bytes.len())
            .ok_or(Failure::Short)
    }

    fn sequence(
        &mut self,
        length: u32,
        keep: bool,
        depth: usize,
    ) -> Result<Vec<Dataset<'a>>, Failure> {
        if depth > DEPTH_MAX {
            return Err(Failure::Damaged("sequences are nested too deeply"));
        }
        let end = if length == UNDEFINED {
            None
        } else {
            Some(self.end(length)?)
        };
        let mut items = Vec::new();
        while end.is_none_or(|end| self.at < end) {
            let tag = self.tag()?;
            let length = self.u32()?;
            match tag {
                tags::ITEM => {}
                tags::SEQUENCE_END if end.is_none() => break,
                _ => {
                    return Err(Failure::Damaged(
                        "a sequence holds something else than items",
                    ));
                }
            }
            if keep {
                self.items += 1;
                if self.items > SMALL_ITEMS_MAX && self.at / self.items < SMALL_ITEM_BYTES {
                    return Err(Failure::Damaged("sequences hold thousands of empty items"));
                }
            }
            let item = self.item(length, depth)?;
            if keep {
                push_tightly(&mut items, item);
            }
        }
        Ok(items)
    }

    fn item(&mut self, length: u32, depth: usize) -> Result<Dataset<'a>, Failure> {
        let mut dataset = Dataset {
            elements: Vec::new(),
            big_endian: self.encoding.big_endian,
        };
        let end = if length == UNDEFINED {
            None
        } else {
            Some(self.end(length)?)
        };
        while end.is_none_or(|end| self.at < end) {
            let element = self.element_header()?;
            if element.tag == tags::ITEM_END {
                break;
            }
            self.value(&element, depth, &mut dataset)?;
        }
        Ok(dataset)
    }
}
