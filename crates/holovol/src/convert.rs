//! `holovol convert`: a volume in another format.

use std::path::{Path, PathBuf};

use holovol_volume::{OutputFormat, RawLayout, WriteError};

use crate::cli::ConvertArgs;
use crate::progress::Bar;
use crate::{Exit, Failure};

pub(crate) fn run(args: &ConvertArgs) -> Result<(), Failure> {
    if OutputFormat::of(&args.out).is_none() {
        let error = WriteError::UnknownFormat {
            path: args.out.clone(),
        };
        return Err(Failure::new(Exit::Output, error.to_string()));
    }
    let bar = Bar::new("loading");
    let volume = holovol_volume::open_with(&args.file, &args.input.options(), &mut |progress| {
        bar.set(progress.fraction(), "");
    })?;
    drop(bar);
    for notice in volume.notices() {
        eprintln!("note: {notice}");
    }
    let part = reserve_part(&args.out)
        .map_err(|error| Failure::new(Exit::Output, format!("{}: {error}", args.out.display())))?;
    let written = holovol_volume::write(&volume, &part, args.lossy)
        .map_err(|error| error.to_string())
        .and_then(|()| put_in_place(&part, &args.out).map_err(|error| error.to_string()));
    written.map_err(|problem| {
        // Nothing more can be done about leftovers that can't be removed either.
        let _ = std::fs::remove_file(&part);
        let _ = std::fs::remove_file(RawLayout::sidecar_path(&part));
        // Its user knows the file by the name that it was to have.
        let (part, out) = (part.display().to_string(), args.out.display().to_string());
        Failure::new(Exit::Output, problem.replace(&part, &out))
    })
}

/// Where the file grows until it is whole: beside, with an ending that means the same format, under
/// a name that nobody had.
fn reserve_part(path: &Path) -> std::io::Result<PathBuf> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut number = 0;
    loop {
        let part = path.with_file_name(format!("part{number}.{name}"));
        match std::fs::File::create_new(&part) {
            Ok(_) if !RawLayout::sidecar_path(&part).exists() => return Ok(part),
            Ok(_) => std::fs::remove_file(&part)?,
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
        number += 1;
    }
}

fn put_in_place(part: &Path, path: &Path) -> std::io::Result<()> {
    let sidecar = RawLayout::sidecar_path(part);
    if OutputFormat::of(path) == Some(OutputFormat::Raw) {
        std::fs::rename(sidecar, RawLayout::sidecar_path(path))?;
    }
    std::fs::rename(part, path)
}
