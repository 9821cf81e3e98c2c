//! No other crate makes an HTTP client of its own: one that uses a proxy would ask it for hardware and frames.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::path::{Path, PathBuf};

/// Ways to make a client that may use a proxy.
const MADE: [&str; 4] = ["reqwest::Client::new(", "reqwest::Client::builder(", "reqwest::get(", "ClientBuilder::new("];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            if !matches!(name.as_str(), "target" | "tests" | "node_modules") && !name.starts_with('.') {
                sources(&path, found);
            }
        } else if name.ends_with(".rs") && !name.contains("tests") {
            found.push(path);
        }
    }
}

#[test]
fn clients_for_hardware_and_our_own_addresses_are_made_in_one_place() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut found = Vec::new();
    sources(&root, &mut found);
    assert!(found.len() > 300, "{} sources", found.len());
    for path in found.iter().filter(|path| !path.ends_with("common/local_http/src/lib.rs")) {
        let text = std::fs::read_to_string(path).unwrap();
        let code = text.split("#[cfg(test)]").next().unwrap();
        for made in MADE {
            assert!(
                !code.contains(made),
                "{}: use local_http::client_builder(), or internet::Client for a server outside the observatory",
                path.display()
            );
        }
    }
}
