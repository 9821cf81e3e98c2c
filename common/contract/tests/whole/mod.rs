//! Documents that are generated as a whole; `UPDATE_DOCS=1` writes them again. For the tests of this crate and of `node-web`.

use std::fs;
use std::path::Path;

/// A whole file is what was generated.
pub fn is(document: &str, generated: &str) {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let path = own.ancestors().find(|folder| folder.join("Cargo.lock").exists()).unwrap().join(document);
    let file = fs::read_to_string(&path).unwrap_or_default().replace("\r\n", "\n");
    if file == generated {
        return;
    }
    if std::env::var("UPDATE_DOCS").is_ok_and(|value| value == "1") {
        fs::write(&path, generated).unwrap();
        return;
    }
    let line = file.lines().zip(generated.lines()).take_while(|(old, new)| old == new).count();
    panic!(
        "{document} is out of date from line {}; run UPDATE_DOCS=1 cargo test -p {}; it says {:?}, the code {:?}",
        line + 1,
        env!("CARGO_PKG_NAME"),
        file.lines().nth(line).unwrap_or_default().trim(),
        generated.lines().nth(line).unwrap_or_default().trim()
    );
}
