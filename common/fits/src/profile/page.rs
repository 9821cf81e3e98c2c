//! The profiles as Markdown, for docs/fits.md.

use std::fmt::Write as _;

use super::computed::COMPUTED;
use super::{KeywordRule, PROFILES, Profile, ProfileError, ProfileName, When};

/// The part of docs/fits.md about the profiles that change a header.
///
/// # Errors
/// A profile has a fault.
pub fn page() -> Result<String, ProfileError> {
    let mut page = String::new();
    for name in PROFILES {
        let profile = Profile::load(name)?;
        // The rules of `astra` are those of FITS.
        if name != ProfileName::Astra {
            one(&mut page, name, &profile);
        }
    }
    page.push_str("\n### Computed values\n\n| value | what it is |\n|---|---|\n");
    for (name, _, what) in COMPUTED {
        // Writing to a String cannot fail.
        let _ = writeln!(page, "| `{name}` | {what} |");
    }
    Ok(page)
}

fn one(page: &mut String, name: ProfileName, profile: &Profile) {
    let _ = write!(page, "\n### Profile `{name}`\n\n{}\n\n", profile.about);
    let _ = write!(page, "Name of a copy: `{}`.\n\n", profile.file_name);
    page.push_str("| keyword | frames | from | must be | rule |\n|---|---|---|---|---|\n");
    for rule in &profile.keyword {
        let expected = rule.expected();
        let must = if rule.required { expected } else { format!("where it is there: {expected}") };
        let _ = writeln!(
            page,
            "| `{}` | {} | {} | {} | {} |",
            rule.name,
            frames(rule.when),
            sources(rule),
            cell(&must),
            cell(&rule.rule)
        );
    }
    for dropped in &profile.drop {
        let _ = writeln!(page, "| `{}` | all | not delivered | not there | {} |", dropped.name, cell(&dropped.rule));
    }
    for public in &profile.public {
        let _ = writeln!(page, "| `{}` | of the sky | | a warning | {} |", public.name, cell(&public.rule));
    }
    if profile.unchanged {
        page.push_str("\nA copy is the file as it is. What breaks these rules is reported by `starmesh fits check`, and copied all the same.\n");
        return;
    }
    let as_they_are: Vec<String> = profile.keep.iter().map(|keyword| format!("`{keyword}`")).collect();
    let commentary = if profile.commentary { "are delivered" } else { "are not delivered" };
    let _ = writeln!(
        page,
        "\nDelivered as they are: {}. COMMENT and HISTORY {commentary}. \
         DATASUM and CHECKSUM are computed for the copy, and must be there and right.",
        as_they_are.join(", ")
    );
}

fn frames(when: When) -> &'static str {
    match when {
        When::Always => "all",
        When::Light => "of the sky",
        When::Calibration => "bias, dark, flat",
        When::Solved => "solved",
    }
}

fn sources(rule: &KeywordRule) -> String {
    let mut from: Vec<String> = rule.from.iter().map(|source| format!("`{source}`")).collect();
    if !rule.map.is_empty() {
        let shown = |(old, new): (&String, &String)| match (old.as_str(), new.as_str()) {
            ("*", "*") => "others as they are".to_owned(),
            _ => format!("{old}: {new}"),
        };
        let map: Vec<String> = rule.map.iter().map(shown).collect();
        let _ = from.last_mut().map(|last| last.push_str(&format!(" ({})", map.join(", "))));
    }
    from.extend(rule.value.as_ref().map(|value| match value {
        super::Constant::Whole(whole) => whole.to_string(),
        super::Constant::Number(number) => format!("{number:?}"),
        super::Constant::Text(text) => format!("'{text}'"),
    }));
    cell(&from.join(", else "))
}

fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}
