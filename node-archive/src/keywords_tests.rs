//! The document that shows every keyword; `UPDATE_DOCS=1 cargo test -p node-archive keywords` writes it again.

use std::collections::BTreeSet;

use crate::document;

#[test]
fn the_page_about_fits_files_is_what_code_and_profiles_declare() {
    document::shows("docs/fits.md", &super::page().unwrap());
}

#[test]
fn a_keyword_of_our_files_is_described_once() {
    let page = super::page().unwrap();
    let ours = page.split("\n### Profile").next().unwrap();
    let cells = ours.lines().filter_map(|line| line.strip_prefix("| `")?.split(" | ").next());
    let mut seen = BTreeSet::new();
    for keyword in cells.flat_map(|cell| cell.split(", ")).map(|keyword| keyword.trim_matches('`')) {
        assert!(seen.insert(keyword), "{keyword} is described twice");
    }
    assert!(["RA", "FRAMEID", "BJD_TDB", "CRVAL1", "DATASUM", "GUIDERMS"].iter().all(|keyword| seen.contains(keyword)));
}
