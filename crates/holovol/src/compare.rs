//! `holovol compare`: how far an image is from a reference.

use std::path::Path;

use holovol_reference::{Image, measures};

use crate::cli::CompareArgs;
use crate::{Exit, Failure, print_json};

#[derive(serde::Serialize)]
struct Line<'a> {
    image: &'a Path,
    reference: &'a Path,
    width: u32,
    height: u32,
    #[serde(flatten)]
    measures: measures::Comparison,
}

pub(crate) fn run(args: &CompareArgs) -> Result<(), Failure> {
    let image = Image::read_exr(&args.image)?;
    let reference = Image::read_exr(&args.reference)?;
    let measures = measures::compare(&image, &reference).map_err(|error| {
        Failure::new(
            Exit::Input,
            format!(
                "{} and {}: {error}",
                args.image.display(),
                args.reference.display()
            ),
        )
    })?;
    print_json(&Line {
        image: &args.image,
        reference: &args.reference,
        width: image.width(),
        height: image.height(),
        measures,
    })
}
