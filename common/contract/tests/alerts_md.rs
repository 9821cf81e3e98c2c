//! `docs/operator/alerts.md` says what the code says; `UPDATE_DOCS=1 cargo test -p contract --test alerts_md` writes it
//! again.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::fs;
use std::path::Path;

const BEGIN: &str = "<!-- generated: begin -->\n";
const END: &str = "<!-- generated: end -->";

#[test]
fn the_page_about_alerts_is_what_the_code_says() {
    let generated = contract::observatory::markdown();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/operator/alerts.md");
    let page = fs::read_to_string(&path).unwrap().replace("\r\n", "\n");
    let (before, rest) = page.split_once(BEGIN).expect("alerts.md has no begin mark");
    let (block, after) = rest.split_once(END).expect("alerts.md has no end mark");
    if block == generated {
        return;
    }
    if std::env::var("UPDATE_DOCS").is_ok_and(|value| value == "1") {
        fs::write(&path, format!("{before}{BEGIN}{generated}{END}{after}")).unwrap();
    } else {
        let line = block.lines().zip(generated.lines()).take_while(|(old, new)| old == new).count();
        panic!(
            "docs/operator/alerts.md is out of date; run UPDATE_DOCS=1 cargo test -p contract --test alerts_md\n \
             it says:  {:?}\n the code: {:?}",
            block.lines().nth(line),
            generated.lines().nth(line)
        );
    }
}
