//! Choosing one of several volumes that lie in one file without names.

use std::path::Path;

use super::ReadOptions;
use super::options::{Content, chosen};
use crate::VolumeError;

/// More entries than this are not listed one by one.
const LISTED_MAX: u64 = 1000;

/// The index among `count` entries that the user chose; the first by default.
pub(super) fn entry(
    options: &ReadOptions,
    path: &Path,
    count: u64,
    kind: &str,
    other: &str,
) -> Result<u64, VolumeError> {
    let Some(choice) = options.choice.as_deref() else {
        return Ok(0);
    };
    if let Some(index) = numbered(choice, count) {
        return Ok(index);
    }
    let contents = contents(count, if count > 1 { kind } else { other });
    match chosen(choice, &contents) {
        Some(index) => Ok(index as u64),
        None => Err(VolumeError::NoSuchChoice {
            path: path.into(),
            choice: choice.into(),
            contents,
        }),
    }
}

/// The index that a number from 1 to `count` names: numbers go on where lists end.
pub(super) fn numbered(choice: &str, count: u64) -> Option<u64> {
    let number: u64 = choice.trim().parse().ok()?;
    (1..=count).contains(&number).then(|| number - 1)
}

/// Entries that have only numbers.
pub(super) fn contents(count: u64, kind: &str) -> Vec<Content> {
    let content = |index: u64| Content {
        description: format!("{kind} {}", index + 1),
        ..Content::default()
    };
    (0..count.min(LISTED_MAX)).map(content).collect()
}

/// What to tell of a file that holds several.
pub(super) fn notice(count: u64, what: &str, entry: u64) -> String {
    format!(
        "the file has {count} {what}: this is number {}; another can be chosen",
        entry + 1
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_beyond_the_list_can_be_chosen() {
        let chosen = |choice: &str| {
            let options = ReadOptions::default().with_choice(choice);
            entry(&options, Path::new("a.nii"), 1200, "volume", "value").ok()
        };
        assert_eq!(
            ["1", "1100", "1200"].map(chosen),
            [Some(0), Some(1099), Some(1199)]
        );
        assert_eq!(["0", "1201", "x"].map(chosen), [None; 3]);
    }
}
