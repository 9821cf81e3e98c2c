//! The header and the name of a delivered copy.

use super::cards::{CardEntry, CardList};
use super::computed::computed;
use super::{KeywordRule, Profile, SUMS, is_structural, is_world};
use crate::card::Value;

/// The header of the copy that a profile makes of a file with these cards. `file` is the name of that file. DATASUM and
/// CHECKSUM are left to the one who writes the pixels.
pub fn convert(cards: &CardList, file: &str, profile: &Profile) -> CardList {
    if profile.unchanged {
        return cards.clone();
    }
    let mut made = CardList::default();
    for entry in &cards.entries {
        let keyword = entry.keyword.as_str();
        let is_new = made.entry(keyword).is_none();
        if entry.value.is_none() {
            if profile.commentary {
                made.entries.push(entry.clone());
            }
        } else if is_structural(keyword) {
            made.entries.push(entry.clone());
        } else if SUMS.contains(&keyword) || profile.dropped(keyword).is_some() || !is_new {
            continue;
        } else if let Some(rule) = profile.rules(keyword, cards).next() {
            // A rule that holds and gives nothing leaves no old value: it may be of another form.
            let new = profile.rules(keyword, cards).find_map(|rule| value_of(rule, cards, file));
            made.entries.extend(new.and_then(|new| entry_of(rule, new, Some(entry))));
        } else if profile.keeps(keyword) {
            made.entries.push(entry.clone());
        }
    }
    for rule in &profile.keyword {
        if rule.when.holds(cards)
            && made.entry(&rule.name).is_none()
            && let Some(value) = value_of(rule, cards, file)
        {
            made.entries.extend(entry_of(rule, value, None));
        }
    }
    in_order(made)
}

/// The value that a rule gives to its keyword.
fn value_of(rule: &KeywordRule, cards: &CardList, file: &str) -> Option<Value> {
    let of = |source: &String| -> Option<Value> {
        let value = match source.starts_with('@') {
            true => computed(source, cards, file),
            false => cards.value(source).cloned(),
        };
        let value = value.filter(|value| !rule.is_none(value))?;
        let Value::Text(text) = &value else { return Some(value) };
        let text = match rule.map.is_empty() {
            true => text.clone(),
            false => match rule.map.get(text).or_else(|| rule.map.get("*"))? {
                same if same == "*" => text.clone(),
                other => other.clone(),
            },
        };
        Some(Value::Text(if rule.upper { text.to_ascii_uppercase() } else { text }))
    };
    rule.from.iter().find_map(of).or_else(|| rule.value.as_ref().map(super::Constant::value))
}

/// The card of a rule; an entry that has this value already is delivered to the byte.
fn entry_of(rule: &KeywordRule, value: Value, old: Option<&CardEntry>) -> Option<CardEntry> {
    match old.filter(|old| old.value.as_ref() == Some(&value)) {
        Some(old) => Some(old.clone()),
        None => CardEntry::new(&rule.name, value, &rule.comment),
    }
}

/// The text that the rules of a keyword give to it, where FITS has no form for that text.
pub(super) fn value_without_form(keyword: &str, cards: &CardList, file: &str, profile: &Profile) -> Option<String> {
    let rule = profile.rules(keyword, cards).next()?;
    match profile.rules(keyword, cards).find_map(|rule| value_of(rule, cards, file))? {
        Value::Text(text) => {
            CardEntry::new(&rule.name, Value::Text(text.clone()), &rule.comment).is_none().then_some(text)
        }
        _ => None,
    }
}

/// The structure of the file first, world coordinates last, with WCSAXES before the others.
fn in_order(cards: CardList) -> CardList {
    let place = |entry: &CardEntry| match entry.keyword.as_str() {
        _ if entry.value.is_none() => 5,
        "WCSAXES" => 3,
        keyword if is_structural(keyword) => 0,
        keyword if is_world(keyword) => 4,
        keyword if keyword.contains(' ') => 2,
        _ => 1,
    };
    let mut entries = cards.entries;
    entries.sort_by_key(place);
    CardList { entries }
}

/// The name of the copy whose header is `made`, of the file `file`.
///
/// # Errors
/// The keyword that the name needs and the header does not have.
pub fn file_name(made: &CardList, file: &str, profile: &Profile) -> Result<String, String> {
    let (mut name, mut rest) = (String::new(), profile.file_name.as_str());
    while let Some((before, behind)) = rest.split_once('{') {
        let (source, after) = behind.split_once('}').unwrap_or((behind, ""));
        name.push_str(before);
        let value = match source.starts_with('@') {
            true => computed(source, made, file),
            false => made.value(source).cloned(),
        };
        match value {
            Some(Value::Text(text)) if source.starts_with('@') => name.push_str(&text),
            // A sign that parts a name of this profile must not come from a name of a site.
            Some(Value::Text(text)) => name.extend(text.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '_')),
            Some(Value::Whole(whole)) => name.push_str(&whole.to_string()),
            _ => return Err(source.to_owned()),
        }
        rest = after;
    }
    name.push_str(rest);
    Ok(name)
}
