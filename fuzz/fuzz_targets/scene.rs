//! Scene files and transfer function files: the text alone, without the files it names.

#![no_main]

use std::path::Path;

use holovol_scene::SceneFile;
use holovol_volume::TransferFunctionFile;

libfuzzer_sys::fuzz_target!(|text: &str| {
    if let Ok(scene) = SceneFile::parse(text) {
        // What was read can be written, and is the same again.
        let json = scene.to_json().expect("it was valid when it was read");
        assert!(SceneFile::parse(&json).is_ok(), "{json}");
    }
    if let Ok(file) = TransferFunctionFile::parse(text, Path::new("fuzz")) {
        for s in [-1e30, 0.0, 0.5, 1e30] {
            let sigma_t = file.transfer_function.eval(s).sigma_t;
            assert!(sigma_t <= file.transfer_function.max_sigma_t(s, s));
        }
    }
});
