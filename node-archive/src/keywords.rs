//! Every keyword of our files and of the copies that archives get, with its source and its rule, as Markdown for
//! docs/fits.md.

use std::fmt::Write as _;

use config::header::{Dtype, HeaderRow, HeaderTable, Source};
use fits::profile;

use crate::quality::GUIDED;
use crate::{astronomy, header, quality, solution};

/// The generated part of docs/fits.md.
///
/// # Errors
/// An embedded profile has a fault.
pub fn page() -> Result<String, profile::ProfileError> {
    let table = HeaderTable::default();
    let mut page =
        "\n### The default table\n\n| keyword | type | source | filled in | meaning |\n|---|---|---|---|---|\n"
            .to_owned();
    for row in &table.rows {
        // Writing to a String cannot fail.
        let _ = writeln!(
            page,
            "| `{}` | {} | {} | {} | {} |",
            row.keyword,
            dtype(row.dtype),
            source(row),
            if row.fixed { "when the file is written" } else { "when the header is completed" },
            meaning(row)
        );
    }
    let is_listed = |keyword: &str| table.rows.iter().any(|row| row.keyword == keyword);
    let known = header::of_every_file().map(|(keyword, comment)| (keyword, "known when the file is written", comment));
    let computed = astronomy::MIDDLE.into_iter().map(|(keyword, comment)| (keyword, "computed", comment));
    let (listed, others): (Vec<_>, Vec<_>) = known.chain(computed).partition(|(keyword, ..)| is_listed(keyword));
    let of_bytes = ["DATASUM", "CHECKSUM"].map(|keyword| (keyword, "", ""));
    let listed: Vec<String> = listed.iter().chain(&of_bytes).map(|(keyword, ..)| format!("`{keyword}`")).collect();
    page.push_str("\n### Of every file, whatever its table lists\n\n");
    let _ = writeln!(page, "Of those above: {}. And:\n", listed.join(", "));
    page.push_str("| keyword | source | meaning |\n|---|---|---|\n");
    for (keyword, source, comment) in others {
        let _ = writeln!(page, "| `{keyword}` | {source} | {comment} |");
    }
    for (keyword, comment) in quality::all() {
        let _ = writeln!(page, "| `{keyword}` | measured on the frame | {comment} |");
    }
    let _ =
        writeln!(page, "| `{GUIDED}` | guiding during the exposure | [pix] rms guide error, px of the guide frames |");
    let plain = solution::PLAIN.into_iter().filter(|keyword| !is_listed(keyword));
    let plain: Vec<String> = plain.map(|keyword| format!("`{keyword}`")).collect();
    let _ = writeln!(page, "| {} | plate solution | world coordinates, whole or not at all |", plain.join(", "));
    page.push_str("| `A_*`, `B_*`, `AP_*`, `BP_*` | plate solution | distortion, where the optics distort |\n");
    page.push_str("| `OBJALT`, `OBJAZ` | computed | [deg] direction of the target at start, unrefracted |\n");
    page.push_str(&profile::page()?);
    Ok(page)
}

fn dtype(dtype: Dtype) -> &'static str {
    match dtype {
        Dtype::Str => "text",
        Dtype::Int => "whole number",
        Dtype::Float => "number",
        Dtype::Bool => "T or F",
    }
}

fn source(row: &HeaderRow) -> String {
    match &row.source {
        Source::Library => "the file's structure".to_owned(),
        Source::Static(text) if text.is_empty() => "the table; empty: left out, or from the configuration".to_owned(),
        Source::Static(text) => format!("the table: {text}"),
        Source::Computed => "computed".to_owned(),
        Source::Property(kind, property) if is_place(row) => {
            format!("the target, known when the file is written; without one {} `{property}`", kind.ascom())
        }
        Source::Property(kind, property) => format!("{} `{property}`", kind.ascom()),
        Source::Metadata(key) => format!("`metadata` of the row: {key}"),
    }
}

/// Whether a row is about the place of the target, or without one about that of the mount.
fn is_place(row: &HeaderRow) -> bool {
    matches!(row.keyword.as_str(), "RA" | "DEC")
}

fn meaning(row: &HeaderRow) -> String {
    let of_target = header::of_every_file().find(|(keyword, _)| is_place(row) && *keyword == row.keyword);
    of_target.map_or_else(|| row.comment.clone(), |(_, comment)| format!("{comment}; without a target {}", row.comment))
}

#[cfg(test)]
#[path = "keywords_tests.rs"]
mod tests;
