use std::collections::BTreeMap;
use std::io::{BufRead, Read};
use std::path::PathBuf;

use glam::{DMat3, DVec3};

use crate::reader::Input;
use crate::reader::numbers::NumberType;
use crate::reader::placement::{METRES_PER_MM, check_directions, checked_origin, checked_spacing};
use crate::{Geometry, VolumeError};

/// Headers have a few hundred bytes; one with a long comment some thousand.
const HEADER_BYTES_MAX: u64 = 1 << 20;

/// More data files than any stack has slices.
const FILES_MAX: usize = 1 << 20;

/// Where the voxels are.
pub(super) enum DataFile<'a> {
    /// After the header.
    Local,
    One(&'a str),
    /// One file per slice; empty: the header's further lines name them.
    List(Vec<String>),
}

pub(super) struct Header {
    path: PathBuf,
    fields: BTreeMap<String, String>,
}

impl Header {
    /// Reads up to and with `ElementDataFile`, which is last by definition.
    pub fn read(input: &mut Input<'_>) -> Result<Self, VolumeError> {
        let path = input.path().to_path_buf();
        let mut header = Self {
            path: path.clone(),
            fields: BTreeMap::new(),
        };
        let mut budget = HEADER_BYTES_MAX;
        let mut line = Vec::new();
        loop {
            line.clear();
            let bytes = input
                .by_ref()
                .take(budget)
                .read_until(b'\n', &mut line)
                .map_err(|source| VolumeError::decoding(&path, source))?;
            budget = budget.saturating_sub(bytes as u64);
            if budget == 0 {
                return Err(header.error(
                    "ElementDataFile",
                    format!("not within the first {HEADER_BYTES_MAX} bytes"),
                    "this line at the header's end",
                ));
            }
            if bytes == 0 {
                return Err(VolumeError::TruncatedHeader {
                    path,
                    format: "MetaImage",
                });
            }
            let text = String::from_utf8_lossy(&line);
            let Some((key, value)) = text.split_once('=') else {
                if text.trim().is_empty() {
                    continue;
                }
                return Err(header.error("a line", "without `=`", "`Key = value`"));
            };
            let key = key.trim().to_owned();
            let is_last = key == "ElementDataFile";
            header.fields.insert(key, value.trim().to_owned());
            if is_last {
                return Ok(header);
            }
        }
    }

    pub fn error(
        &self,
        field: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> VolumeError {
        VolumeError::Field {
            path: self.path.clone(),
            format: "MetaImage",
            field: field.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    fn field(&self, names: &[&str]) -> Option<&str> {
        names
            .iter()
            .find_map(|&name| self.fields.get(name))
            .map(String::as_str)
    }

    fn required(&self, name: &str) -> Result<&str, VolumeError> {
        self.field(&[name])
            .ok_or_else(|| self.error(name, "missing", "this field in every MetaImage header"))
    }

    /// Numbers of a field, as many as asked for.
    fn numbers(&self, names: &[&str], count: usize) -> Result<Option<Vec<f64>>, VolumeError> {
        let Some(text) = self.field(names) else {
            return Ok(None);
        };
        let numbers: Option<Vec<f64>> = text.split_whitespace().map(|n| n.parse().ok()).collect();
        numbers
            .filter(|numbers| numbers.len() == count)
            .map(Some)
            .ok_or_else(|| {
                self.error(
                    names.first().copied().unwrap_or_default(),
                    format!("{text:?}"),
                    format!("{count} numbers"),
                )
            })
    }

    /// A field that says True or False; False if it is absent.
    pub fn flag(&self, names: &[&str]) -> Result<bool, VolumeError> {
        match self.field(names).map(str::to_lowercase).as_deref() {
            Some("true" | "t" | "1" | "yes" | "y") => Ok(true),
            None | Some("false" | "f" | "0" | "no" | "n") => Ok(false),
            Some(other) => Err(self.error(
                names.first().copied().unwrap_or_default(),
                format!("{other:?}"),
                "True or False",
            )),
        }
    }

    fn axes(&self) -> Result<usize, VolumeError> {
        let text = self.required("NDims")?;
        let axes = text.parse().ok().filter(|axes| (1..=10).contains(axes));
        axes.ok_or_else(|| self.error("NDims", format!("{text:?}"), "1 to 10"))
    }

    /// Sizes of all axes, fastest first, none of them 0.
    pub fn sizes(&self) -> Result<Vec<u64>, VolumeError> {
        let axes = self.axes()?;
        let text = self.required("DimSize")?;
        text.split_whitespace()
            .map(|word| word.parse::<u64>().ok().filter(|&size| size > 0))
            .collect::<Option<Vec<_>>>()
            .filter(|sizes| sizes.len() == axes)
            .ok_or_else(|| {
                self.error(
                    "DimSize",
                    format!("{text:?}"),
                    format!("{axes} whole numbers, 1 or more each"),
                )
            })
    }

    /// Voxels along x, y, z; axes that the file doesn't have count 1.
    pub fn dims(&self) -> Result<[u32; 3], VolumeError> {
        let mut dims = [1; 3];
        for (dim, size) in dims.iter_mut().zip(self.sizes()?) {
            *dim = u32::try_from(size).map_err(|_| {
                self.error(
                    "DimSize",
                    size.to_string(),
                    "at most 4294967295 along an axis",
                )
            })?;
        }
        Ok(dims)
    }

    pub fn channels(&self) -> Result<u64, VolumeError> {
        let Some(text) = self.field(&["ElementNumberOfChannels"]) else {
            return Ok(1);
        };
        let channels = text.parse().ok().filter(|&channels| channels > 0);
        channels
            .ok_or_else(|| self.error("ElementNumberOfChannels", format!("{text:?}"), "1 or more"))
    }

    pub fn number_type(&self) -> Result<NumberType, VolumeError> {
        if !self.flag(&["BinaryData"]).unwrap_or(true) && self.field(&["BinaryData"]).is_some() {
            return Err(VolumeError::Unsupported {
                path: self.path.clone(),
                what: "`BinaryData = False` (numbers as text) can't be read".into(),
                way_out: "save it with BinaryData = True".into(),
            });
        }
        let name = self.required("ElementType")?;
        Ok(match name.trim_end_matches("_ARRAY") {
            "MET_UCHAR" => NumberType::U8,
            "MET_CHAR" => NumberType::I8,
            "MET_USHORT" => NumberType::U16,
            "MET_SHORT" => NumberType::I16,
            // 32 bits wherever MetaIO runs today, whatever a long is there.
            "MET_UINT" | "MET_ULONG" => NumberType::U32,
            "MET_INT" | "MET_LONG" => NumberType::I32,
            "MET_ULONG_LONG" => NumberType::U64,
            "MET_LONG_LONG" => NumberType::I64,
            "MET_FLOAT" => NumberType::F32,
            "MET_DOUBLE" => NumberType::F64,
            _ => {
                return Err(self.error(
                    "ElementType",
                    format!("{name:?}"),
                    "MET_UCHAR, MET_CHAR, MET_USHORT, MET_SHORT, MET_UINT, MET_INT, \
                     MET_ULONG_LONG, MET_LONG_LONG, MET_FLOAT or MET_DOUBLE",
                ));
            }
        })
    }

    /// Bytes before the data; `None` if the data is at the file's end (-1).
    pub fn skip(&self) -> Result<Option<u64>, VolumeError> {
        match self.field(&["HeaderSize"]) {
            None => Ok(Some(0)),
            Some("-1") => Ok(None),
            Some(text) => text.parse().map(Some).map_err(|_| {
                self.error("HeaderSize", format!("{text:?}"), "0 or more bytes, or -1")
            }),
        }
    }

    pub fn data_file(&self) -> Result<DataFile<'_>, VolumeError> {
        let name = self.required("ElementDataFile")?;
        if name.eq_ignore_ascii_case("local") {
            return Ok(DataFile::Local);
        }
        let words: Vec<&str> = name.split_whitespace().collect();
        if words.first().is_some_and(|word| *word == "LIST") {
            return Ok(DataFile::List(Vec::new()));
        }
        if let &[pattern, first, last, ref rest @ ..] = words.as_slice()
            && pattern.contains('%')
        {
            let step = rest.first().copied().unwrap_or("1");
            let number = |word: &str| word.parse::<u64>().ok();
            let names = numbered(pattern, number(first), number(last), step.parse().ok());
            return names.map(DataFile::List).ok_or_else(|| {
                self.error(
                    "ElementDataFile",
                    format!("{name:?}"),
                    "a pattern such as slice%03d.raw with first, last and step",
                )
            });
        }
        if name.is_empty() {
            return Err(self.error("ElementDataFile", "empty", "LOCAL or a file name"));
        }
        Ok(DataFile::One(name))
    }

    pub fn geometry(&self, notices: &mut Vec<String>) -> Result<Geometry, VolumeError> {
        let axes = self.axes()?;
        let spacing = self.numbers(&["ElementSpacing", "ElementSize"], axes)?;
        if spacing.is_none() {
            notices.push("the header gives no ElementSpacing: taken as 1 mm".into());
        }
        let at = |list: &Option<Vec<f64>>, index: usize| {
            list.as_ref().and_then(|list| list.get(index)).copied()
        };
        // An image is as thick as its pixels are wide.
        let thin = (0..axes.min(3))
            .map(|axis| at(&spacing, axis).unwrap_or(1.0).abs())
            .fold(f64::INFINITY, f64::min);
        let lengths = [0, 1, 2].map(|axis| {
            let length = at(&spacing, axis).unwrap_or(1.0);
            if axis < axes { length } else { thin }
        });
        let spacing = checked_spacing(lengths, METRES_PER_MM, "ElementSpacing", notices);
        let matrix = self.numbers(&["TransformMatrix", "Rotation", "Orientation"], axes * axes)?;
        let origin = self.numbers(&["Offset", "Position", "Origin"], axes)?;
        let origin = [0, 1, 2].map(|axis| at(&origin, axis).unwrap_or(0.0) * METRES_PER_MM);

        let steps = if matrix.is_some() {
            let mut columns = [0, 1, 2].map(|axis| {
                if axis >= axes {
                    return DVec3::ZERO;
                }
                let entry = |row: usize| {
                    if row < axes {
                        at(&matrix, axis * axes + row).unwrap_or(0.0)
                    } else {
                        0.0
                    }
                };
                DVec3::new(entry(0), entry(1), entry(2))
            });
            if axes < 3 {
                columns[2] = DVec3::Z;
            }
            if axes < 2 {
                columns[1] = DVec3::Y;
            }
            let [x, y, z] = columns;
            DMat3::from_cols(x, y, z) * DMat3::from_diagonal(DVec3::from_array(spacing))
        } else if let Some(letters) = self.anatomical() {
            letters * DMat3::from_diagonal(DVec3::from_array(spacing))
        } else {
            notices.push("no TransformMatrix: the patient's directions are not known".into());
            return Ok(Geometry::from_spacing(spacing));
        };
        if let Err(problem) = check_directions(&steps) {
            notices.push(format!(
                "TransformMatrix's directions are {problem}: orientation is not known"
            ));
            return Ok(Geometry::from_spacing(spacing));
        }
        let ras_from_lps = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
        Ok(Geometry::from_ras(
            ras_from_lps * steps,
            checked_origin(ras_from_lps * DVec3::from_array(origin)),
        ))
    }

    /// `AnatomicalOrientation` as axes in LPS: the letters say where an axis comes *from*.
    fn anatomical(&self) -> Option<DMat3> {
        let letters = self.field(&["AnatomicalOrientation"])?.to_uppercase();
        let mut columns = letters.chars().map(|letter| match letter {
            'R' => Some(DVec3::X),
            'L' => Some(-DVec3::X),
            'A' => Some(DVec3::Y),
            'P' => Some(-DVec3::Y),
            'I' => Some(DVec3::Z),
            'S' => Some(-DVec3::Z),
            _ => None,
        });
        let mut next = || columns.next().flatten();
        Some(DMat3::from_cols(next()?, next()?, next()?))
            .filter(|axes| axes.determinant().abs() > 0.5)
    }
}

/// The names that lines after the header list, one each.
pub(super) fn list(input: &mut Input<'_>) -> Result<Vec<String>, VolumeError> {
    let path = input.path().to_path_buf();
    let mut names = Vec::new();
    let mut bytes = Vec::new();
    input
        .take(HEADER_BYTES_MAX)
        .read_to_end(&mut bytes)
        .map_err(|source| VolumeError::decoding(&path, source))?;
    let text = String::from_utf8_lossy(&bytes);
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        names.push(line.to_owned());
    }
    Ok(names)
}

/// The names of `pattern` (with one `%d` or `%03d`) from the first to the last number, which a
/// negative step counts down.
pub(in crate::reader) fn numbered(
    pattern: &str,
    first: Option<u64>,
    last: Option<u64>,
    step: Option<i64>,
) -> Option<Vec<String>> {
    let (first, last, step) = (first?, last?, step.filter(|&step| step != 0)?);
    let (before, rest) = pattern.split_once('%')?;
    let (digits, after) = rest.split_once('d')?;
    let width: usize = if digits.is_empty() {
        0
    } else {
        digits.parse().ok()?
    };
    let size = step.unsigned_abs();
    let span = if step > 0 {
        last.checked_sub(first)?
    } else {
        first.checked_sub(last)?
    };
    if width > 20 || span / size >= FILES_MAX as u64 {
        return None;
    }
    let number = |index: u64| {
        if step > 0 {
            first + index * size
        } else {
            first - index * size
        }
    };
    Some(
        (0..=span / size)
            .map(|index| format!("{before}{:0width$}{after}", number(index)))
            .collect(),
    )
}
