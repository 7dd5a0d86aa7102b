//! Radiance and OpenEXR environment maps: read exactly, refused in words, never a panic.

use std::path::{Path, PathBuf};

use exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes,
    WritableImage, f16,
};
use holovol_light::{EnvironmentMap, LightError};
use proptest::prelude::*;

fn load_bytes(bytes: &[u8]) -> Result<EnvironmentMap, LightError> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    EnvironmentMap::load(file.path())
}

fn radiance_file(header: &str, resolution: &str, pixels: &[u8]) -> Vec<u8> {
    let mut bytes = format!("#?RADIANCE\n{header}\n{resolution}\n").into_bytes();
    bytes.extend(pixels);
    bytes
}

/// An 8 × 2 picture in the newer coding: red runs, green counts up.
fn coded_pixels() -> Vec<u8> {
    let mut bytes = Vec::new();
    for row in 0..2u8 {
        bytes.extend([2, 2, 0, 8]);
        bytes.extend([128 + 8, 100 + row]);
        bytes.extend([8, 0, 1, 2, 3, 4, 5, 6, 7]);
        bytes.extend([128 + 4, 9, 128 + 4, 10]);
        bytes.extend([128 + 8, 129]);
    }
    bytes
}

fn exr_file(compression: Compression, names: [&str; 3], half: bool) -> Vec<u8> {
    let (width, height) = (40usize, 20usize);
    let value = |channel: usize, i: usize| (i * (channel + 1)) as f32 * 0.25;
    let channels = (0..3).map(|channel| {
        let values = (0..width * height).map(|i| value(channel, i));
        let samples = if half {
            FlatSamples::F16(values.map(f16::from_f32).collect())
        } else {
            FlatSamples::F32(values.collect())
        };
        AnyChannel::new(names[channel], samples)
    });
    let layer = Layer::new(
        (width, height),
        LayerAttributes::default(),
        Encoding {
            compression,
            ..Encoding::SMALL_FAST_LOSSLESS
        },
        AnyChannels::sort(channels.collect()),
    );
    let mut bytes = std::io::Cursor::new(Vec::new());
    let image = Image::from_layer(layer);
    image
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .unwrap();
    bytes.into_inner()
}

#[test]
fn radiance_runs_and_counts_are_decoded() {
    let map = load_bytes(&radiance_file(
        "FORMAT=32-bit_rle_rgbe\n",
        "-Y 2 +X 8",
        &coded_pixels(),
    ));
    let map = map.unwrap();
    assert_eq!((map.width(), map.height()), (8, 2));
    // Exponent 129: mantissa/256 · 2.
    assert_eq!(map.texels()[0], [100.0 / 128.0, 0.0, 9.0 / 128.0]);
    assert_eq!(map.texels()[15], [101.0 / 128.0, 7.0 / 128.0, 10.0 / 128.0]);
}

#[test]
fn radiance_headers_may_be_odd() {
    let plain = load_bytes(&radiance_file("", "-Y 2 +X 8", &coded_pixels())).unwrap();
    let odd = "#?RADIANCE\n# made by hand\nGAMMA=1\nPRIMARIES=0 0 0 0 0 0 0 0\nFORMAT=32-bit_rle_rgbe\nmkillum x\n";
    let odd = load_bytes(&radiance_file(odd, "-Y 2 +X 8", &coded_pixels())).unwrap();
    assert_eq!(plain, odd);
    let exposed = "EXPOSURE=2\nEXPOSURE= 0.25\nCOLORCORR=1 2 4\n";
    let exposed = load_bytes(&radiance_file(exposed, "-Y 2 +X 8", &coded_pixels())).unwrap();
    let [r, g, b] = plain.texels()[15];
    assert_eq!(exposed.texels()[15], [r * 2.0, g, b / 2.0]);
}

#[test]
fn radiance_orientation_is_honoured() {
    let plain = load_bytes(&radiance_file("", "-Y 2 +X 8", &coded_pixels())).unwrap();
    let turned = load_bytes(&radiance_file("", "+Y 2 -X 8", &coded_pixels())).unwrap();
    let mut reversed = plain.texels().to_vec();
    reversed.reverse();
    assert_eq!(turned.texels(), reversed);
    let rotated = load_bytes(&radiance_file("", "+X 8 -Y 2", &coded_pixels()));
    assert!(
        rotated
            .unwrap_err()
            .to_string()
            .contains("-Y height +X width")
    );
}

#[test]
fn radiance_older_coding_is_decoded() {
    // One pixel, then 1 + 256·1 repetitions in two bytes, then a flat pixel.
    let pixels = [10, 20, 30, 128, 1, 1, 1, 1, 1, 1, 1, 1, 40, 50, 60, 128];
    let map = load_bytes(&radiance_file("", "-Y 1 +X 259", &pixels)).unwrap();
    assert_eq!(
        map.texel(257, 0),
        [10.0 / 256.0, 20.0 / 256.0, 30.0 / 256.0]
    );
    assert_eq!(
        map.texel(258, 0),
        [40.0 / 256.0, 50.0 / 256.0, 60.0 / 256.0]
    );
    let endless = [10, 20, 30, 128].into_iter().chain([1, 1, 1, 0].repeat(64));
    let endless: Vec<u8> = endless.collect();
    assert!(load_bytes(&radiance_file("", "-Y 1 +X 259", &endless)).is_err());
}

#[test]
fn openexr_is_read_with_every_lossless_compression() {
    for compression in [
        Compression::Uncompressed,
        Compression::RLE,
        Compression::ZIP1,
        Compression::ZIP16,
        Compression::PIZ,
    ] {
        for half in [false, true] {
            let map = load_bytes(&exr_file(compression, ["R", "G", "B"], half)).unwrap();
            assert_eq!((map.width(), map.height()), (40, 20), "{compression:?}");
            assert_eq!(map.texel(7, 3), [127.0 * 0.25, 127.0 * 0.5, 127.0 * 0.75]);
        }
    }
}

#[test]
fn openexr_prefixed_channels_are_found_and_others_named() {
    let map = load_bytes(&exr_file(Compression::RLE, ["a.R", "a.G", "a.B"], false)).unwrap();
    assert_eq!(map.texel(1, 0), [0.25, 0.5, 0.75]);
    let error = load_bytes(&exr_file(Compression::RLE, ["X", "Y", "Z"], false)).unwrap_err();
    assert!(error.to_string().contains("X, Y, Z"), "{error}");
}

#[test]
fn wrong_and_damaged_files_say_what_they_are() {
    let error = |bytes: &[u8]| load_bytes(bytes).unwrap_err().to_string();
    assert!(error(b"\x89PNG\r\n\x1a\n").contains("expected Radiance .hdr or OpenEXR .exr"));
    assert!(error(b"").contains("neither"));
    let pixels = coded_pixels();
    let truncated = radiance_file("", "-Y 2 +X 8", &pixels[..pixels.len() - 1]);
    assert!(error(&truncated).contains("scanline 1 of 2: the file breaks off"));
    assert!(
        error(&radiance_file(
            "FORMAT=32-bit_rle_xyze\n",
            "-Y 2 +X 8",
            &pixels
        ))
        .contains("xyze")
    );
    assert!(error(&radiance_file("EXPOSURE=0\n", "-Y 2 +X 8", &pixels)).contains("EXPOSURE"));
    assert!(error(&radiance_file("", "-Y 0 +X 8", &pixels)).contains("8 × 0"));
    let huge = radiance_file("", "-Y 1099511627776 +X 1099511627776", &pixels);
    assert!(error(&huge).contains("at most 16384 × 8192"));
    // The largest size that is allowed, and nothing behind it: refused at once.
    assert!(error(&radiance_file("", "-Y 8192 +X 16384", &pixels)).contains("scanline 0"));
    let missing = EnvironmentMap::load(Path::new("nowhere.hdr")).unwrap_err();
    assert!(matches!(missing, LightError::Io { .. }));
    assert!(missing.to_string().contains("nowhere.hdr"));
    let exr = exr_file(Compression::ZIP16, ["R", "G", "B"], true);
    assert!(load_bytes(&exr[..exr.len() / 2]).is_err());
}

fn panoramas() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/hdri");
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("skipped: {} is absent", folder.display());
    None
}

#[test]
fn panoramas_have_their_recorded_peaks() {
    let Some(folder) = panoramas() else { return };
    for (name, peak) in [
        ("blocky_photo_studio_1k.hdr", 5408.0),
        ("brown_photostudio_02_1k.hdr", 89.0),
        ("chinese_garden_1k.hdr", 78848.0),
        ("dancing_hall_1k.hdr", 636.0),
        ("hilly_terrain_01_1k.exr", 23680.0),
        ("kloppenheim_05_1k.hdr", 83456.0),
        ("lebombo_1k.hdr", 41.25),
        ("narrow_moonlit_road_1k.hdr", 89088.0),
        ("potsdamer_platz_1k.hdr", 11.8125),
        ("spiaggia_di_mondello_1k.hdr", 72704.0),
        ("spruit_sunrise_1k.hdr", 222208.0),
        ("studio_small_03_1k.hdr", 3568.0),
    ] {
        let map = EnvironmentMap::load(&folder.join(name)).unwrap();
        assert_eq!(
            (map.width(), map.height(), map.replaced()),
            (1024, 512, 0),
            "{name}"
        );
        let found = map.texels().iter().flatten().fold(0.0f32, |a, &b| a.max(b));
        assert_eq!(found, peak, "{name}");
    }
    let map = EnvironmentMap::load(&folder.join("spruit_sunrise_1k.hdr")).unwrap();
    let index = map.texels().iter().position(|t| t[0] == 222208.0).unwrap();
    assert_eq!(map.texels()[index], [222208.0, 154624.0, 44032.0]);
    assert_eq!(index % 1024, 613);
}

fn damaged(seed: Vec<u8>) -> impl Strategy<Value = Vec<u8>> {
    let length = seed.len();
    let edits = prop::collection::vec((0..length, any::<u8>()), 0..12);
    (edits, 0..=length).prop_map(move |(edits, end)| {
        let mut bytes = seed.clone();
        for (at, byte) in edits {
            bytes[at] = byte;
        }
        // Mostly whole: a file cut short is refused early.
        if end % 4 == 0 {
            bytes.truncate(end);
        }
        bytes
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_radiance_never_panics(
        bytes in damaged(radiance_file("FORMAT=32-bit_rle_rgbe\nEXPOSURE=1\n", "-Y 2 +X 8", &coded_pixels()))
    ) {
        let _ = load_bytes(&bytes);
    }

    #[test]
    fn damaged_openexr_never_panics(
        bytes in prop_oneof![
            damaged(exr_file(Compression::Uncompressed, ["R", "G", "B"], false)),
            damaged(exr_file(Compression::RLE, ["R", "G", "B"], true)),
            damaged(exr_file(Compression::ZIP16, ["R", "G", "B"], true)),
            damaged(exr_file(Compression::PIZ, ["R", "G", "B"], true)),
            damaged(exr_file(Compression::PXR24, ["R", "G", "B"], false)),
            damaged(exr_file(Compression::B44, ["R", "G", "B"], true)),
            damaged(exr_file(Compression::DWAA(None), ["R", "G", "B"], true)),
        ]
    ) {
        let _ = load_bytes(&bytes);
    }
}
