//! Documents that show what the code declares, between two marks; `UPDATE_DOCS=1` writes them again. For the tests of this
//! crate, of `schedule` and of `node-archive`.

use std::fs;
use std::path::Path;

const BEGIN: &str = "<!-- generated: begin -->\n";
const END: &str = "<!-- generated: end -->";

/// The part of a document between its marks is what was generated.
pub fn shows(document: &str, generated: &str) {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = own.ancestors().find(|folder| folder.join("Cargo.lock").exists()).unwrap();
    let path = root.join(document);
    let page = text(&path);
    let (before, rest) = page.split_once(BEGIN).unwrap_or_else(|| panic!("{document} has no begin mark"));
    let (block, after) = rest.split_once(END).unwrap_or_else(|| panic!("{document} has no end mark"));
    if block == generated {
        return;
    }
    if std::env::var("UPDATE_DOCS").is_ok_and(|value| value == "1") {
        fs::write(&path, format!("{before}{BEGIN}{generated}{END}{after}")).unwrap();
        return;
    }
    let line = block.lines().zip(generated.lines()).take_while(|(old, new)| old == new).count();
    panic!(
        "{document} is out of date; run UPDATE_DOCS=1 cargo test -p {}\n it says:  {:?}\n the code: {:?}",
        env!("CARGO_PKG_NAME"),
        block.lines().nth(line),
        generated.lines().nth(line)
    );
}

pub fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())).replace("\r\n", "\n")
}
