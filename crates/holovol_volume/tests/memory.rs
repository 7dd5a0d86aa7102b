//! Peak memory of reading, as Linux counts it: at most 2.5 × the voxels' own size.

#![cfg(target_os = "linux")]

use std::fs;
use std::io::Write;
use std::path::Path;

/// A `/proc/self/status` line in bytes.
fn status(field: &str) -> f64 {
    let status = fs::read_to_string("/proc/self/status").expect("Linux has it");
    let line = status.lines().find(|line| line.starts_with(field));
    let kilobytes = line.and_then(|line| line.split_whitespace().nth(1));
    1024.0
        * kilobytes
            .and_then(|n| n.parse::<f64>().ok())
            .expect("a number")
}

const FILE: &str = "HOLOVOL_MEMORY_TEST_FILE";

/// Reads the file that the environment names, in a process of its own; see [`check`].
#[test]
fn child() {
    let Some(path) = std::env::var_os(FILE) else {
        return;
    };
    let [before, virtual_before] = ["VmHWM", "VmPeak"].map(status);
    let start = std::time::Instant::now();
    let result = holovol_volume::open(Path::new(&path), &mut |_| {});
    let seconds = start.elapsed().as_secs_f64();
    let reserved = status("VmPeak") - virtual_before;
    let name = Path::new(&path).file_name().unwrap_or_default().display();
    let volume = match result {
        Ok(volume) => volume,
        Err(error) => {
            println!(
                "{name} × refused, {:.1} MB reserved: {error}",
                reserved / 1e6
            );
            assert!(name.to_string().starts_with("claims"), "{error}");
            assert!(
                reserved < 32e6,
                "{reserved} bytes reserved for what isn't there"
            );
            return;
        }
    };
    let size = (volume.voxels().len() * volume.voxels().kind().bytes()) as f64;
    let peak = (status("VmHWM") - before) / size;
    println!("{name}: {peak:.2} × {:.1} MB, {seconds:.2} s", size / 1e6);
    assert!(
        peak > 0.9,
        "{peak} can't be: the voxels themselves are counted"
    );
    assert!(peak <= 2.5, "{peak} × the voxels' size");
    assert!(reserved <= 2.5 * size + 8e6, "{reserved} bytes reserved");
}

/// The allocator keeps what is freed, so that every file needs a fresh process.
fn check(path: &Path) {
    let child = std::env::current_exe().expect("this binary");
    let output = std::process::Command::new(child)
        .args(["--exact", "child", "--nocapture"])
        .env(FILE, path)
        // glibc sets 64 MB of addresses aside for each thread, whatever it allocates.
        .env("MALLOC_ARENA_MAX", "1")
        .output()
        .expect("it can be run");
    let text = String::from_utf8_lossy(&output.stdout);
    println!(
        "{}",
        text.lines()
            .find(|line| line.contains('×'))
            .unwrap_or(&text)
    );
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

fn nifti(datatype: i16, side: i16, voxels: impl Iterator<Item = Vec<u8>>, out: &mut dyn Write) {
    let mut header = [0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348i32.to_le_bytes());
    for (axis, dim) in [3, side, side, side].into_iter().enumerate() {
        put(40 + 2 * axis, &dim.to_le_bytes());
    }
    put(70, &datatype.to_le_bytes());
    put(108, &352f32.to_le_bytes());
    put(344, b"n+1\0");
    out.write_all(&header).expect("it can be written");
    for voxel in voxels {
        out.write_all(&voxel).expect("it can be written");
    }
    out.flush().expect("it can be written");
}

#[test]
fn reading_needs_little_more_than_the_voxels() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    let create = |name: &str| std::io::BufWriter::new(fs::File::create(path(name)).expect("new"));
    let count = 256u32.pow(3);
    let smooth = |i: u32| (i as f32 * 1e-4).sin();
    let floats = || (0..count).map(|i| smooth(i).to_le_bytes().to_vec());
    nifti(16, 256, floats(), &mut create("f32.nii"));
    let mut packed =
        flate2::write::GzEncoder::new(create("f32.nii.gz"), flate2::Compression::fast());
    nifti(16, 256, floats(), &mut packed);
    packed
        .finish()
        .and_then(|mut file| file.flush())
        .expect("it can be written");
    // Half of it fits 8 bits, then 16, then none: every widening is paid for.
    let doubles = (0..count / 8).map(|i| f64::from(i / 64) * f64::from(i / 1_000_000) * 0.5);
    nifti(
        64,
        128,
        doubles.map(|v| v.to_le_bytes().to_vec()),
        &mut create("f64.nii"),
    );

    check(&path("f32.nii"));
    check(&path("f32.nii.gz"));
    check(&path("f64.nii"));

    // 943 MB of voxels are claimed, which a megabyte of gzip could hold, but noise doesn't.
    let mut claims =
        flate2::write::GzEncoder::new(create("claims.nii.gz"), flate2::Compression::fast());
    nifti(
        2,
        980,
        (0..1u32 << 18).map(|i| i.wrapping_mul(2_654_435_761).to_le_bytes().to_vec()),
        &mut claims,
    );
    claims
        .finish()
        .and_then(|mut file| file.flush())
        .expect("it can be written");
    check(&path("claims.nii.gz"));
    // A table of tags that claims 2.7 GB; found by fuzzing.
    let damaged = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/phantoms/damaged");
    fs::copy(damaged.join("huge_table.tif"), path("claims.tif")).expect("it can be copied");
    check(&path("claims.tif"));

    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/volumes");
    if shared.is_dir() {
        check(&shared.join("heptane_jet_combustion.nii.gz"));
        check(&shared.join("cta_thoracic_aorta.nii.gz"));
        check(&shared.join("lidc-idri-0314_ct_thorax_dicom"));
        check(&shared.join("mouse_brain_microscopy.mhd"));
        check(&shared.join("wdas_cloud_sixteenth.vdb"));
    } else {
        eprintln!("skipped: {} is not there", shared.display());
    }
}
