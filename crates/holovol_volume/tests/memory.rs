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
fn try_check(path: &Path) -> Result<(), String> {
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
    if output.status.success() {
        Ok(())
    } else {
        Err(String::from_utf8_lossy(&output.stderr).into_owned())
    }
}

/// See [`try_check`].
fn check(path: &Path) {
    if let Err(error) = try_check(path) {
        panic!("{}: {error}", path.display());
    }
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

/// A stack of `side` pages with noise in the lower half of each number.
fn tiff(compression: ::tiff::encoder::Compression, side: u32, out: impl Write + std::io::Seek) {
    let mut encoder = ::tiff::encoder::TiffEncoder::new(out)
        .expect("it can be written")
        .with_compression(compression);
    for page in 0..side {
        let pixel = |i: u32| ((i ^ page) << 8 | i.wrapping_mul(2_654_435_761) >> 24) as u16;
        let pixels: Vec<u16> = (0..side * side).map(pixel).collect();
        encoder
            .write_image::<::tiff::encoder::colortype::Gray16>(side, side, &pixels)
            .expect("it can be written");
    }
}

/// A file of `count` frames, each the one of a phantom that is compressed.
fn frames(phantom: &str, count: usize) -> Vec<u8> {
    frames_of(phantom, count, None)
}

/// The same, with something else for the compressed frame.
fn frames_of(phantom: &str, count: usize, other: Option<&[u8]>) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/phantoms/formats/codecs");
    let bytes = fs::read(folder.join(phantom)).expect("the phantom");
    let pixels = [
        0xe0, 0x7f, 0x10, 0x00, b'O', b'B', 0, 0, 0xff, 0xff, 0xff, 0xff,
    ];
    let at = bytes
        .windows(pixels.len())
        .position(|window| window == pixels)
        .expect("compressed pixels");
    let (header, data) = bytes.split_at(at);
    let mut items = data.get(pixels.len()..).expect("items");
    let mut item = || {
        let length = u32::from_le_bytes(*items[4..].first_chunk().expect("a length")) as usize;
        let (item, rest) = items.split_at(8 + length);
        items = rest;
        item
    };
    item();
    let fragment = item();
    let number = format!("{count:<6}");
    let end = [0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0];
    [
        header,
        &[0x28, 0, 8, 0, b'I', b'S', 6, 0],
        number.as_bytes(),
        &pixels,
        &[0xfe, 0xff, 0x00, 0xe0, 0, 0, 0, 0],
        &other.unwrap_or(fragment).repeat(count),
        &end,
    ]
    .concat()
}

fn zipped(name: &str, content: &[u8], zeros: usize) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated);
    writer.start_file(name, options).expect("it can be written");
    writer.write_all(content).expect("it can be written");
    let chunk = vec![0; 1 << 20];
    for _ in 0..zeros >> 20 {
        writer.write_all(&chunk).expect("it can be written");
    }
    writer.finish().expect("it can be written").into_inner()
}

/// The beginning of a DICOM file with a private element that claims `length` bytes.
fn long_element(length: u32) -> Vec<u8> {
    let mut bytes = vec![0; 128];
    bytes.extend(b"DICM\x02\x00\x10\x00UI\x14\x001.2.840.10008.1.2.1\0");
    bytes.extend(b"\x09\x00\x10\x00OB\0\0");
    bytes.extend(length.to_le_bytes());
    bytes
}

#[test]
fn small_files_take_little_memory() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut failures = Vec::new();
    let mut write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).expect("it can be written");
        failures.extend(try_check(&path).err());
    };
    let size = 200 << 20;
    // Zeros that unpack to 200 MB of header, ...
    let header = long_element(size as u32 + 1000);
    write("claims_header.zip", &zipped("a.dcm", &header, size));
    // ... to a TIFF without pages, ...
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(b"II*\0\x08\0\0\0").expect("packed");
    packed.write_all(&vec![0; size]).expect("packed");
    write("claims_nothing.tif.gz", &packed.finish().expect("packed"));
    // ... and 65,535 members in a hundred bytes.
    let mut archive = zipped("a.dcm", b"nothing", 0);
    let end = archive.len() - 22;
    archive[end + 8..end + 12].fill(0xff);
    write("claims_members.zip", &archive);
    // Frames of 8,000 × 8,000 pixels in a few kilobytes, by every codec.
    for codec in ["rle", "jpegls", "jpeg2000", "jpeg_lossless"] {
        let mut bytes = frames(&format!("u12_{codec}.dcm"), 3);
        for tag in [
            [0x28, 0, 0x10, 0, b'U', b'S', 2, 0],
            [0x28, 0, 0x11, 0, b'U', b'S', 2, 0],
        ] {
            let at = bytes
                .windows(8)
                .position(|window| window == tag)
                .expect("rows and columns");
            bytes[at + 8..at + 10].copy_from_slice(&8000u16.to_le_bytes());
        }
        write(&format!("claims_{codec}.dcm"), &bytes);
    }
    // Frames of nothing.
    let tiny = frames_of("u12_rle.dcm", 100_000, Some(b"\xfe\xff\x00\xe0\0\0\0\0"));
    write("claims_frames.dcm", &tiny);
    // A deflated page that claims a gigabyte.
    let mut page = std::io::Cursor::new(Vec::new());
    tiff(
        ::tiff::encoder::Compression::Deflate(::tiff::encoder::DeflateLevel::Fast),
        16,
        &mut page,
    );
    let mut page = page.into_inner();
    let mut huge = 0;
    for at in 0..page.len() - 12 {
        // ImageWidth, ImageLength, RowsPerStrip: single numbers of 32 bits.
        let is_size = [[0, 1], [1, 1], [0x16, 1]].contains(&[page[at], page[at + 1]]);
        if is_size && page[at + 2..at + 8] == [4, 0, 1, 0, 0, 0] {
            page[at + 8..at + 12].copy_from_slice(&6000u32.to_le_bytes());
            huge += 1;
        }
    }
    assert_eq!(huge, 48, "in 16 pages");
    write("claims_page.tif", &page);
    // A directory that is cut off, whose first table claims 3 million values.
    let mut cut = b"MM\0\x2b\0\x08\0\0\0\0\0\0\0\0\0\x10".to_vec();
    cut.extend(15u64.to_be_bytes());
    cut.extend([1, 0, 0, 4]);
    cut.extend(0x002d_0000u64.to_be_bytes());
    cut.extend([0, 0, 0, 0, 0, 0, 0, 8]);
    cut.resize(258, 0);
    write("claims_table.tif", &cut);
    assert!(failures.is_empty(), "{failures:#?}");
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

    // TIFF, and DICOM in frames, by every codec.
    use ::tiff::encoder::{Compression, DeflateLevel};
    for (name, compression) in [
        ("plain.tif", Compression::Uncompressed),
        ("lzw.tif", Compression::Lzw),
        ("deflate.tif", Compression::Deflate(DeflateLevel::Fast)),
    ] {
        tiff(compression, 224, &mut create(name));
        check(&path(name));
    }
    for codec in ["rle", "jpegls", "jpeg2000", "jpeg_lossless"] {
        let name = format!("{codec}.dcm");
        let bytes = frames(&format!("u12_{codec}.dcm"), 3000);
        fs::write(path(&name), bytes).expect("it can be written");
        check(&path(&name));
    }

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
