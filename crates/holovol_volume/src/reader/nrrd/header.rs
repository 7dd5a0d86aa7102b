use std::collections::BTreeMap;
use std::io::{BufRead, Read};
use std::path::PathBuf;

use crate::reader::Input;
use crate::reader::metaimage::numbered;
use crate::reader::numbers::NumberType;
use crate::{Label, VolumeError};

/// Headers with a page of diffusion gradients have tens of kilobytes; anything like this is none.
const HEADER_BYTES_MAX: u64 = 4 << 20;

/// The format allows this many axes.
const AXES_MAX: u64 = 16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Raw,
    Text,
    Hex,
    Gzip,
    Bzip2,
}

/// A header's fields by name, in lower case and without spaces: `data file` is `datafile`.
pub(super) struct Header {
    path: PathBuf,
    fields: BTreeMap<String, String>,
    /// `key:=value` lines.
    notes: BTreeMap<String, String>,
    /// What follows `data file: LIST`.
    list: Vec<String>,
}

/// Where the voxels are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum DataFile {
    Attached,
    One(String),
    Several(Vec<String>),
}

impl Header {
    /// Reads up to the empty line that ends the header, or to the end of a detached one.
    pub fn read(input: &mut Input<'_>) -> Result<Self, VolumeError> {
        let path = input.path().to_path_buf();
        let mut header = Self {
            path: path.clone(),
            fields: BTreeMap::new(),
            notes: BTreeMap::new(),
            list: Vec::new(),
        };
        let mut budget = HEADER_BYTES_MAX;
        let mut line = Vec::new();
        for number in 1u32.. {
            line.clear();
            let bytes = input
                .by_ref()
                .take(budget)
                .read_until(b'\n', &mut line)
                .map_err(|source| VolumeError::decoding(&path, source))?
                as u64;
            budget -= bytes;
            if budget == 0 {
                return Err(header.error(
                    "the header",
                    format!("longer than {HEADER_BYTES_MAX} bytes"),
                    "an empty line that ends it",
                ));
            }
            let text = String::from_utf8_lossy(&line);
            let text = text.trim_end();
            if number == 1 {
                header.check_magic(text)?;
                continue;
            }
            if text.is_empty() {
                let ended = bytes > 0;
                if !ended && !header.fields.contains_key("datafile") {
                    return Err(VolumeError::TruncatedHeader {
                        path,
                        format: "NRRD",
                    });
                }
                break;
            }
            header.take_line(number, text)?;
            let is_list = |name: &String| name == "LIST" || name.starts_with("LIST ");
            if header.fields.get("datafile").is_some_and(is_list) {
                header.take_list(input, budget)?;
                break;
            }
        }
        Ok(header)
    }

    /// The names after `data file: LIST`, one a line, up to the end.
    fn take_list(&mut self, input: &mut Input<'_>, budget: u64) -> Result<(), VolumeError> {
        let mut bytes = Vec::new();
        input
            .take(budget)
            .read_to_end(&mut bytes)
            .map_err(|source| VolumeError::decoding(&self.path, source))?;
        let text = String::from_utf8_lossy(&bytes);
        let names = text.lines().map(str::trim).filter(|name| !name.is_empty());
        self.list = names.map(str::to_owned).collect();
        Ok(())
    }

    /// What a segmentation (`.seg.nrrd`) calls its values; `None` if this is none.
    pub fn labels(&self) -> Option<Vec<Label>> {
        let note = |number: usize, what: &str| self.notes.get(&format!("Segment{number}_{what}"));
        note(0, "ID").or_else(|| note(0, "LabelValue"))?;
        let labels = (0..self.notes.len()).map_while(|number| {
            let value = note(number, "LabelValue")?.parse::<f64>().ok()?;
            let color = note(number, "Color").and_then(|text| {
                let parts: Vec<f32> = text
                    .split_whitespace()
                    .filter_map(|part| part.parse().ok())
                    .filter(|part| (0.0..=1.0).contains(part))
                    .collect();
                <[f32; 3]>::try_from(parts).ok()
            });
            Some(Label {
                value,
                name: note(number, "Name").cloned().unwrap_or_default(),
                color,
            })
        });
        Some(labels.collect())
    }

    fn check_magic(&self, line: &str) -> Result<(), VolumeError> {
        let version = line
            .strip_prefix("NRRD")
            .and_then(|v| v.parse::<u32>().ok());
        match version {
            Some(1..=5) => Ok(()),
            _ => Err(self.error(
                "magic",
                format!("{:?}", line.chars().take(12).collect::<String>()),
                "NRRD0001 to NRRD0005 as the first line",
            )),
        }
    }

    fn take_line(&mut self, number: u32, line: &str) -> Result<(), VolumeError> {
        if line.starts_with('#') {
            return Ok(());
        }
        let colon = line.find(':').ok_or_else(|| {
            self.error(
                format!("line {number}"),
                format!("{:?}", line.chars().take(40).collect::<String>()),
                "`field: value`, `key:=value` or `# comment`",
            )
        })?;
        let (name, rest) = line.split_at(colon);
        let value = rest.trim_start_matches(':');
        // `key:=value` is a note by its writer, not a field.
        if let Some(note) = value.strip_prefix('=') {
            // Only a segmentation's are of use.
            if name.starts_with("Segment") {
                self.notes.insert(name.to_owned(), note.trim().to_owned());
            }
            return Ok(());
        }
        let name: String = name
            .chars()
            .filter(|c| !c.is_whitespace())
            .flat_map(char::to_lowercase)
            .collect();
        self.fields.insert(name, value.trim().to_owned());
        Ok(())
    }

    pub fn error(
        &self,
        field: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> VolumeError {
        VolumeError::Field {
            path: self.path.clone(),
            format: "NRRD",
            field: field.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub fn unsupported(&self, what: impl Into<String>, way_out: &str) -> VolumeError {
        VolumeError::Unsupported {
            path: self.path.clone(),
            what: what.into(),
            way_out: way_out.into(),
        }
    }

    /// A field by its full name; `None` if it is absent.
    pub fn field(&self, name: &str) -> Option<&str> {
        let squeezed: String = name.chars().filter(|c| *c != ' ').collect();
        self.fields.get(&squeezed).map(String::as_str)
    }

    fn required(&self, name: &str) -> Result<&str, VolumeError> {
        self.field(name)
            .ok_or_else(|| self.error(name, "missing", "this field in every NRRD header"))
    }

    pub fn number_type(&self) -> Result<NumberType, VolumeError> {
        let name = self.required("type")?;
        Ok(match name.to_lowercase().as_str() {
            "uchar" | "unsigned char" | "uint8" | "uint8_t" => NumberType::U8,
            "char" | "signed char" | "int8" | "int8_t" => NumberType::I8,
            "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => {
                NumberType::U16
            }
            "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
                NumberType::I16
            }
            "uint" | "unsigned int" | "uint32" | "uint32_t" => NumberType::U32,
            "int" | "signed int" | "int32" | "int32_t" => NumberType::I32,
            "ulonglong"
            | "unsigned long long"
            | "unsigned long long int"
            | "uint64"
            | "uint64_t" => NumberType::U64,
            "longlong"
            | "long long"
            | "long long int"
            | "signed long long"
            | "signed long long int"
            | "int64"
            | "int64_t" => NumberType::I64,
            "float" => NumberType::F32,
            "double" => NumberType::F64,
            "block" => {
                return Err(self.unsupported(
                    "`type: block` holds no numbers",
                    "save the values as integers or floats",
                ));
            }
            _ => {
                return Err(self.error(
                    "type",
                    format!("{name:?}"),
                    "an integer type of 8 to 64 bits (such as `unsigned short`), float or double",
                ));
            }
        })
    }

    pub fn encoding(&self) -> Result<Encoding, VolumeError> {
        let name = self.required("encoding")?;
        match name.to_lowercase().as_str() {
            "raw" => Ok(Encoding::Raw),
            "txt" | "text" | "ascii" => Ok(Encoding::Text),
            "hex" => Ok(Encoding::Hex),
            "gz" | "gzip" => Ok(Encoding::Gzip),
            "bz2" | "bzip2" => Ok(Encoding::Bzip2),
            _ => Err(self.error(
                "encoding",
                format!("{name:?}"),
                "raw, gzip, bzip2, ascii (text) or hex",
            )),
        }
    }

    /// Whether numbers of several bytes begin with their highest one.
    pub fn big_endian(&self) -> Result<bool, VolumeError> {
        match self.field("endian").map(str::to_lowercase).as_deref() {
            Some("big") => Ok(true),
            Some("little") => Ok(false),
            Some(other) => Err(self.error("endian", format!("{other:?}"), "little or big")),
            None => Err(self.error(
                "endian",
                "missing",
                "little or big, as the values have more than one byte: add the line that fits",
            )),
        }
    }

    /// Sizes of all axes, fastest first, none of them 0.
    pub fn sizes(&self) -> Result<Vec<u64>, VolumeError> {
        let dimension = self.required("dimension")?;
        let axes = dimension
            .parse::<u64>()
            .ok()
            .filter(|axes| (1..=AXES_MAX).contains(axes))
            .ok_or_else(|| self.error("dimension", format!("{dimension:?}"), "1 to 16"))?;
        let text = self.required("sizes")?;
        let size = |word: &str| word.parse::<u64>().ok().filter(|&size| size > 0);
        text.split_whitespace()
            .map(size)
            .collect::<Option<Vec<_>>>()
            .filter(|sizes| sizes.len() as u64 == axes)
            .ok_or_else(|| {
                self.error(
                    "sizes",
                    format!("{text:?}"),
                    format!("{axes} whole numbers, 1 or more each"),
                )
            })
    }

    /// `line skip` or `byte skip`; 0 if absent.
    pub fn skip(&self, name: &str) -> Result<i64, VolumeError> {
        self.field(name).map_or(Ok(0), |text| {
            text.parse::<i64>()
                .map_err(|_| self.error(name, format!("{text:?}"), "a whole number"))
        })
    }

    /// Where the voxels are.
    pub fn data_file(&self) -> Result<DataFile, VolumeError> {
        let Some(name) = self.field("data file") else {
            return Ok(DataFile::Attached);
        };
        if name.is_empty() {
            return Err(self.error("data file", "empty", "the name of the data file"));
        }
        if name == "LIST" || name.starts_with("LIST ") {
            return Ok(DataFile::Several(self.list.clone()));
        }
        let words: Vec<&str> = name.split_whitespace().collect();
        if let &[pattern, first, last, step, ..] = words.as_slice()
            && pattern.contains('%')
        {
            let number = |word: &str| word.parse::<u64>().ok();
            let names = numbered(pattern, number(first), number(last), step.parse().ok());
            return names.map(DataFile::Several).ok_or_else(|| {
                self.error(
                    "data file",
                    format!("{name:?}"),
                    "a pattern such as slice%03d.raw with first, last (0 or more) and a step towards it",
                )
            });
        }
        Ok(DataFile::One(name.to_owned()))
    }
}
