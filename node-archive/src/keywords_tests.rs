//! The document that shows every keyword; `UPDATE_DOCS=1 cargo test -p node-archive keywords` writes it again.

use crate::document;

#[test]
fn the_page_about_fits_files_is_what_code_and_profiles_declare() {
    document::shows("docs/fits.md", &super::page().unwrap());
}
