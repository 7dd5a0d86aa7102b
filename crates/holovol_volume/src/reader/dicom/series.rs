//! Finding the series among files.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use glam::DVec3;

use super::files::Files;
use super::header::{self, Image, Photometric, Pixels};
use super::stack::{Slice, Stack};
use crate::VolumeError;
use crate::reader::options::{Content, chosen};
use crate::reader::{CancelFlag, ReadOptions, parallel};

/// Directions whose cosine is above this are the same.
const SAME_DIRECTION: f64 = 0.999_99;

/// Spacings within this part are the same.
const SAME_SPACING: f64 = 1e-4;

/// More ways than this to lie in space are no stacks; frames are then compared with the last only.
const GROUPS_COMPARED: usize = 64;

/// All images of some files.
pub(super) struct Study {
    pub images: Vec<Image>,
    /// Ordered by series number.
    pub series: Vec<Series>,
    /// Files that were looked at.
    pub files: usize,
    /// Why images can't be shown, each reason once, with how many images it concerns.
    pub unreadable: Vec<(String, usize)>,
}

/// A stack that can be shown.
pub(super) struct Series {
    pub content: Content,
    pub stack: Stack,
}

impl Study {
    /// Reads all headers.
    ///
    /// # Errors
    /// If a DICOM file is damaged, a file can't be read, or reading is cancelled.
    pub fn find(files: &dyn Files, path: &Path, cancel: &CancelFlag) -> Result<Self, VolumeError> {
        let mut images = Vec::new();
        parallel::for_each(
            0..files.count(),
            |index| header::read(files, index),
            |image| {
                if cancel.is_cancelled() {
                    return Err(VolumeError::Cancelled { path: path.into() });
                }
                images.extend(image);
                Ok(())
            },
        )?;
        images.sort_by_key(|image| image.file);
        // The same image twice, under two names; not what only has the same name, as anonymisers do.
        let mut seen = HashSet::new();
        images.retain(|image| {
            let places = image.frames.iter().map(|frame| frame.position);
            let place = |at: DVec3| at.to_array().map(f64::to_bits);
            let places: Vec<_> = places.map(|at| at.map(place)).collect();
            image.instance_uid.is_empty() || seen.insert((image.instance_uid.clone(), places))
        });

        let mut unreadable: Vec<(String, usize)> = Vec::new();
        for reason in images.iter().filter_map(|image| image.unreadable.as_ref()) {
            match unreadable.iter_mut().find(|(known, _)| known == reason) {
                Some((_, count)) => *count += 1,
                None => unreadable.push((reason.clone(), 1)),
            }
        }
        let series = group(&images);
        Ok(Self {
            images,
            series,
            files: files.count(),
            unreadable,
        })
    }

    /// The series that the user wants; the only one, if there is one.
    pub fn choose(&self, path: &Path, options: &ReadOptions) -> Result<&Series, VolumeError> {
        let contents = || self.series.iter().map(|s| s.content.clone()).collect();
        if self.series.is_empty() {
            let reasons: Vec<String> = self
                .unreadable
                .iter()
                .map(|(reason, count)| format!("{count}: {reason}"))
                .collect();
            return Err(VolumeError::NothingFound {
                path: path.into(),
                files: self.files,
                reasons: if reasons.is_empty() {
                    String::new()
                } else {
                    format!(" ({})", reasons.join("; "))
                },
            });
        }
        let index = match (&options.choice, self.series.len()) {
            (None, 1) => Some(0),
            (None, _) => {
                return Err(VolumeError::Choose {
                    path: path.into(),
                    what: "series",
                    contents: contents(),
                });
            }
            (Some(choice), _) => chosen(choice, &contents()),
        };
        index
            .and_then(|index| self.series.get(index))
            .ok_or_else(|| VolumeError::NoSuchChoice {
                path: path.into(),
                choice: options.choice.clone().unwrap_or_default(),
                contents: contents(),
            })
    }
}

/// What frames must share to be stacked, apart from how they lie.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Kind {
    series_uid: String,
    size: [u16; 5],
    signed: bool,
    float: bool,
    inverted: bool,
    is_localizer: bool,
    echo: u64,
    b_value: u64,
    temporal: u64,
}

impl Kind {
    fn of(image: &Image, slice: &Slice) -> Self {
        let Pixels {
            rows,
            columns,
            bits_allocated,
            bits_stored,
            high_bit,
            signed,
            float,
        } = image.pixels;
        Self {
            series_uid: image.series_uid.clone(),
            size: [rows, columns, bits_allocated, bits_stored, high_bit],
            signed,
            float,
            inverted: image.photometric == Photometric::Monochrome1,
            is_localizer: image.is_localizer,
            echo: slice.frame.echo.to_bits(),
            b_value: slice.frame.b_value.to_bits(),
            temporal: slice.frame.temporal.to_bits(),
        }
    }
}

fn lie_alike(a: &Slice, b: &Slice) -> bool {
    let axes = match (a.frame.axes, b.frame.axes) {
        (Some(a), Some(b)) => a
            .iter()
            .zip(&b)
            .all(|(a, b)| a.dot(*b) > SAME_DIRECTION * a.length() * b.length()),
        (None, None) => true,
        _ => false,
    };
    let spacing = match (a.frame.spacing, b.frame.spacing) {
        (Some(a), Some(b)) => a
            .iter()
            .zip(&b)
            .all(|(a, b)| (a - b).abs() <= SAME_SPACING * a.abs()),
        (None, None) => true,
        _ => false,
    };
    axes && spacing && a.frame.position.is_some() == b.frame.position.is_some()
}

fn group(images: &[Image]) -> Vec<Series> {
    let mut kinds: Vec<(Kind, Vec<Vec<Slice>>)> = Vec::new();
    let mut places: HashMap<Kind, usize> = HashMap::new();
    for (number, image) in images.iter().enumerate() {
        if image.unreadable.is_some() {
            continue;
        }
        for frame in &image.frames {
            let slice = Slice {
                image: number,
                frame: frame.clone(),
            };
            let kind = Kind::of(image, &slice);
            let place = *places.entry(kind.clone()).or_insert_with(|| {
                kinds.push((kind, Vec::new()));
                kinds.len() - 1
            });
            let Some((_, groups)) = kinds.get_mut(place) else {
                continue;
            };
            let compared = groups.iter_mut().rev().take(GROUPS_COMPARED);
            let like = |group: &&mut Vec<Slice>| {
                group.first().is_some_and(|first| lie_alike(first, &slice))
            };
            match compared.into_iter().find(like) {
                Some(group) => group.push(slice),
                None => groups.push(vec![slice]),
            }
        }
    }
    let mut series: Vec<(f64, String, Series)> = Vec::new();
    for (kind, groups) in kinds {
        let stacks: Vec<Stack> = groups.into_iter().flat_map(Stack::split).collect();
        for stack in stacks {
            let Some(image) = stack
                .slices
                .first()
                .and_then(|slice| images.get(slice.image))
            else {
                continue;
            };
            series.push((
                image.series_number,
                kind.series_uid.clone(),
                Series {
                    content: describe(image, &stack),
                    stack,
                },
            ));
        }
    }
    // Stable: parts of a series stay in the order of their files.
    series.sort_by(|(a, x, _), (b, y, _)| a.total_cmp(b).then_with(|| x.cmp(y)));
    let mut series: Vec<Series> = series.into_iter().map(|(_, _, series)| series).collect();
    number_equals(&mut series);
    series
}

fn describe(image: &Image, stack: &Stack) -> Content {
    let mut parts = Vec::new();
    let modality = if image.modality.is_empty() {
        "image"
    } else {
        image.modality.as_str()
    };
    parts.push(modality.to_owned());
    if image.is_localizer {
        parts.push("localizer".into());
    }
    if !image.description.is_empty() {
        parts.push(format!("\"{}\"", image.description));
    }
    if let Some(slice) = stack.slices.first() {
        if slice.frame.echo > 0.0 && image.modality == "MR" {
            parts.push(format!("echo at {} ms", slice.frame.echo));
        }
        if slice.frame.b_value > 0.0 {
            parts.push(format!("b = {} s/mm²", slice.frame.b_value));
        }
        if slice.frame.temporal > 0.0 {
            parts.push(format!("time {}", slice.frame.temporal));
        }
    }
    if let Some(codes) = stack.geometry.axis_codes() {
        parts.push(codes);
    }
    Content {
        name: String::new(),
        description: parts.join(" "),
        dims: Some([
            image.pixels.columns.into(),
            image.pixels.rows.into(),
            stack.slices.len() as u64,
        ]),
        spacing: Some(stack.geometry.spacing()),
    }
}

/// Parts of a series that look the same are told by a number.
fn number_equals(series: &mut [Series]) {
    let mut counts: HashMap<String, (usize, usize)> = HashMap::new();
    for one in series.iter() {
        counts.entry(one.content.description.clone()).or_default().0 += 1;
    }
    for one in series.iter_mut() {
        if let Some((count, told)) = counts.get_mut(&one.content.description)
            && *count > 1
        {
            *told += 1;
            let number = *told;
            one.content.description.push_str(&format!(" part {number}"));
        }
    }
}
