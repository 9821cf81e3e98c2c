//! `docs/bus.md` says what the code says; `UPDATE_DOCS=1 cargo test -p contract --test bus_md` writes it again.

use std::fs;
use std::path::Path;

const BEGIN: &str = "<!-- generated: begin -->\n";
const END: &str = "<!-- generated: end -->";

#[test]
fn the_page_about_the_bus_is_what_the_code_says() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let sample = |name: &str| {
        let path = here.join("golden/v1").join(format!("{name}.json"));
        fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).replace("\r\n", "\n")
    };
    let generated = contract::table::markdown(sample);
    let path = here.join("../../docs/bus.md");
    let page = fs::read_to_string(&path).unwrap().replace("\r\n", "\n");
    let (before, rest) = page.split_once(BEGIN).expect("bus.md has no begin mark");
    let (block, after) = rest.split_once(END).expect("bus.md has no end mark");
    if block == generated {
        return;
    }
    if std::env::var("UPDATE_DOCS").is_ok_and(|value| value == "1") {
        fs::write(&path, format!("{before}{BEGIN}{generated}{END}{after}")).unwrap();
    } else {
        let line = block.lines().zip(generated.lines()).take_while(|(old, new)| old == new).count();
        panic!(
            "docs/bus.md is out of date; run UPDATE_DOCS=1 cargo test -p contract --test bus_md\n it says:  {:?}\n the code: {:?}",
            block.lines().nth(line),
            generated.lines().nth(line)
        );
    }
}
