//! What takes long: folders of very many files, and every kilobyte of real files. Nightly it is
//! all done (`HOLOVOL_NIGHTLY=1`), else a part.

use std::fs;
use std::path::Path;
use std::time::Instant;

use holovol_volume::{Input, ReadOptions, open, read};

use crate::formats::folder;

fn is_nightly() -> bool {
    std::env::var_os("HOLOVOL_NIGHTLY").is_some_and(|value| value == "1")
}

/// A series lies among very many files that are no images, and is found soon.
#[test]
fn a_series_among_very_many_files_is_found() {
    let count = if is_nightly() { 100_000 } else { 2000 };
    let study = tempfile::tempdir().expect("a temporary folder");
    for number in 0..count {
        let part = study.path().join(format!("{}", number / 25_000));
        fs::create_dir_all(&part).expect("a folder");
        fs::write(part.join(format!("{number}.txt")), b"no image").expect("written");
    }
    let start = Instant::now();
    let refused = match open(study.path(), &mut |_| {}) {
        Ok(volume) => panic!("read {:?}", volume.dims()),
        Err(error) => error.to_string(),
    };
    assert!(
        refused.contains(&format!("none of the {count} files")),
        "{refused}"
    );
    for name in ["0.dcm", "1.dcm", "2.dcm"] {
        fs::copy(
            folder().join("dicom_explicit").join(name),
            study.path().join(name),
        )
        .expect("copied");
    }
    let volume = open(study.path(), &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(volume.dims(), [5, 4, 3]);
    let seconds = start.elapsed().as_secs_f64();
    println!("{count} files, read twice: {seconds:.1} s");
    assert!(seconds < 60.0, "{seconds}");
}

/// No beginning of a real file is read as the whole, or takes long, or panics.
#[test]
fn real_files_cut_off_at_every_kilobyte_are_refused() {
    let volumes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/volumes");
    if !volumes.is_dir() {
        eprintln!("skipped: {} is not there", volumes.display());
        return;
    }
    let thorax = fs::read_dir(volumes.join("lidc-idri-0314_ct_thorax_dicom")).expect("the thorax");
    let slice = thorax.flatten().next().expect("a slice").path();
    let mut paths = vec![slice];
    for name in [
        "wdas_cloud_sixteenth.vdb",
        "stent_aorta_ct.nrrd",
        "iguana_head_microct.nii.gz",
    ] {
        paths.push(volumes.join(name));
    }
    let step = if is_nightly() { 1 << 10 } else { 50 << 10 };
    for path in paths {
        let bytes = fs::read(&path).expect("it can be read");
        for length in (0..bytes.len()).step_by(step) {
            let start = Instant::now();
            let input = Input::from_bytes(&path, &bytes[..length]);
            let result = read(input, &ReadOptions::default(), &mut |_| {});
            let name = path.display();
            let Err(error) = result else {
                panic!("{length} of {} bytes of {name} are read", bytes.len());
            };
            let text = error.to_string();
            assert!(
                text.starts_with(&name.to_string()) && text.len() > name.to_string().len() + 20,
                "{text}"
            );
            assert!(
                start.elapsed().as_secs_f64() < 5.0,
                "{length} bytes of {name} take long"
            );
        }
    }
}
