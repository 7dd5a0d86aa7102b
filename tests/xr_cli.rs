//! `holovol xr` where there is no headset.

#![cfg(feature = "xr")]

use std::process::Command;

#[test]
fn without_a_runtime_it_says_what_is_missing_and_what_else_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let scan = folder.path().join("scan.nrrd");
    std::fs::write(&scan, b"not read so soon").expect("a file");
    let output = Command::new(env!("CARGO_BIN_EXE_holovol"))
        .arg("xr")
        .arg(&scan)
        .env("XR_RUNTIME_JSON", folder.path().join("none.json"))
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(8), "{said}");
    for part in [
        "OpenXR",
        "install",
        &format!("holovol preview {}", scan.display()),
        "holovol xr --simulate",
    ] {
        let is_said = said.contains(part) || part == "install" && said.contains("start the one");
        assert!(is_said, "{part}: {said}");
    }
    assert!(output.stdout.is_empty());
}

#[test]
fn files_are_looked_for_before_headsets() {
    let output = Command::new(env!("CARGO_BIN_EXE_holovol"))
        .args(["xr", "there-is-no.nrrd"])
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("there-is-no.nrrd"), "{said}");
}
