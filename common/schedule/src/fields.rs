//! Reads one row of a schedule from its JSON object, and reports all that is wrong with it.

use std::collections::BTreeMap;
use std::sync::Arc;

use config::{meant, nearest};
use contract::Name;
use contract::device::camera::Purpose;
use contract::observatory::{Check, Finding};
use serde_json::{Map, Value};
use units::Utc;

use crate::action::{ACTIONS, Action, Entry};
use crate::fault::{Right as _, error};
use crate::row::{PartOfRow, Row, RowId};
use crate::times::{self, Read};
use crate::written::{Of, Position, Written};
use crate::wrong::{Mend, Wrong};

const FIELDS: [&str; 6] = ["device_name", "action_type", "action_value", "start_time", "end_time", "programme"];
/// Written by Astra into its own output, meaningless on reading.
const IGNORED: [&str; 2] = ["completed", "status"];
/// So many fields of one row are reported.
const MOST_WRONG: usize = 16;
/// The text for an unknown parameter.
const UNKNOWN: &str = "unknown parameter";
/// No action has so many parameters; a row with more is reported once.
const MOST_PARAMETERS: usize = 200;
const DAY_S: f64 = 86_400.0;

/// Parameters of rows that do not give them, by camera and action.
pub type Defaults = BTreeMap<String, BTreeMap<String, Map<String, Value>>>;

/// The defaults that a configuration's cameras give to their rows.
pub fn defaults_of(cameras: &[config::Camera]) -> Defaults {
    let of_camera = |camera: &config::Camera| {
        let values = serde_json::to_value(&camera.defaults).and_then(serde_json::from_value);
        // Every value that TOML can hold is JSON.
        (camera.common.name.to_string(), values.unwrap_or_default())
    };
    cameras.iter().filter(|camera| !camera.defaults.is_empty()).map(of_camera).collect()
}

/// Parameters with those defaults, and without those that are `null`: they are as if they were not there.
fn whole(mut given: Map<String, Value>, defaults: Option<&Map<String, Value>>) -> Map<String, Value> {
    given.retain(|_, value| !value.is_null());
    for (key, value) in defaults.into_iter().flatten() {
        given.entry(key.as_str()).or_insert_with(|| value.clone());
    }
    given
}

/// A row's object while it is read.
struct RowObject<'a> {
    object: &'a Map<String, Value>,
    written: &'a mut Written,
    findings: &'a mut Vec<Finding>,
}

/// The row; with faults that are surely mended, as it is then. Else as much of it as could be read.
pub(super) fn row(
    object: &Map<String, Value>,
    id: RowId,
    mut written: Written,
    (cameras, defaults): (&[Name], &Defaults),
    findings: &mut Vec<Finding>,
) -> Result<Row, PartOfRow> {
    let object = &named(object, &mut written, findings);
    let mut source = RowObject { object, written: &mut written, findings };
    let camera = source.camera(cameras);
    let action = source.action(camera.as_ref().and_then(|camera| defaults.get(camera.as_str())));
    let window = source.window();
    let programme = source.programme();
    let written = Arc::new(written);
    match (camera, action, window) {
        (Some(camera), Some(action), Some((start, end))) => {
            let line = usize::try_from(written.begin.line).unwrap_or(usize::MAX);
            Ok(Row { id, line, written, camera, action, programme, start, end })
        }
        (camera, _, window) => Err(PartOfRow { written, camera, filters: filters(object), window }),
    }
}

/// The filters that a row names, whatever else is wrong with it.
fn filters(object: &Map<String, Value>) -> Vec<String> {
    let named = object.get("action_value").and_then(|value| value.get("filter"));
    let each = match named {
        Some(Value::Array(several)) => several.as_slice(),
        Some(one) => std::slice::from_ref(one),
        None => &[],
    };
    each.iter().filter_map(Value::as_str).map(str::to_owned).collect()
}

/// A row with the names that were meant; reports unknown ones, and known ones that stand twice.
fn named(object: &Map<String, Value>, written: &mut Written, findings: &mut Vec<Finding>) -> Map<String, Value> {
    for (name, at) in written.doubled().take(MOST_WRONG) {
        findings.push(error(Check::Schema, at, Some(name), "stands twice in this row").right("leave one"));
    }
    let is_known = |key: &str| FIELDS.contains(&key) || IGNORED.contains(&key);
    let is_parameter = |key: &str| ACTIONS.iter().any(|entry| !entry.schema()["properties"][key].is_null());
    let mut meant_object = object.clone();
    for key in object.keys().filter(|key| !is_known(key.as_str())).take(MOST_WRONG) {
        let at = written.key(Of::Row, key);
        let found = error(Check::Schema, at, Some(key), format!("unknown key {key:?}"));
        if is_parameter(key) {
            findings.push(found.right("it belongs into action_value"));
            continue;
        }
        let mend = Mend::name(key, FIELDS);
        findings.push(found.right(meant(key, FIELDS)).fix(written.mend(Of::Row, key, Some(mend.clone()))));
        if let Mend::Name(near) = mend
            && !meant_object.contains_key(&near)
        {
            let given = meant_object.remove(key).unwrap_or_default();
            written.rename(Of::Row, key, &near);
            meant_object.insert(near, given);
        }
    }
    meant_object
}

impl<'a> RowObject<'a> {
    fn report(&mut self, finding: Finding) {
        self.findings.push(finding);
    }

    /// A field that holds a text.
    fn text(&mut self, key: &'static str) -> Option<&'a str> {
        let object = self.object;
        match object.get(key) {
            Some(Value::String(text)) => Some(text),
            Some(other) => {
                let at = self.written.value(Of::Row, key);
                self.report(error(Check::Schema, at, Some(key), format!("expected a text, found {}", short(other))));
                None
            }
            None => {
                self.report(error(Check::Schema, self.written.begin, Some(key), format!("{key} is missing")));
                None
            }
        }
    }

    /// The camera, or the one that was meant.
    fn camera(&mut self, cameras: &[Name]) -> Option<Name> {
        let wanted = self.text("device_name")?;
        let named = |name: &str| cameras.iter().find(|known| known.as_str() == name).cloned();
        if let Some(camera) = named(wanted) {
            return Some(camera);
        }
        let at = self.written.field("device_name");
        let known = cameras.iter().map(Name::as_str);
        let found = error(Check::Device, at, Some("device_name"), format!("no camera is named {wanted:?}"));
        let fix = self.written.mend(Of::Row, "device_name", Mend::word(wanted, known.clone()));
        self.report(found.right(meant(wanted, known.clone())).fix(fix));
        nearest(wanted, known).and_then(named)
    }

    /// Its window, or the one that was meant.
    fn window(&mut self) -> Option<(Utc, Utc)> {
        let (start, end) = (self.time("start_time"), self.time("end_time"));
        let (start, end) = (start?, end?);
        if start < end {
            return Some((start, end));
        }
        let at = self.written.field("end_time");
        let what = format!("end_time {} is not after start_time {}", when(end), when(start));
        let found = error(Check::Time, at, Some("end_time"), what);
        // An hour after midnight with the date of the evening.
        let next_day = end.plus_seconds(DAY_S);
        if next_day <= start || next_day.seconds_since(start) > 0.75 * DAY_S {
            self.report(found);
            return None;
        }
        let right = when(next_day);
        let mend = Mend::Value(Value::from(right.as_str()).to_string());
        let fix = self.written.mend(Of::Row, "end_time", Some(mend));
        self.report(found.right(format!("did you mean {right}?")).fix(fix));
        Some((start, next_day))
    }

    /// The id of the programme, where the row names one; it becomes a keyword of FITS headers.
    fn programme(&mut self) -> Option<String> {
        const KEY: &str = "programme";
        if matches!(self.object.get(KEY), None | Some(Value::Null)) {
            return None;
        }
        let text = self.text(KEY)?.trim();
        if !Purpose::is_programme(text) {
            let at = self.written.field(KEY);
            let what = format!(
                "{text:?} is no id of a programme: expected 1 to {} letters, digits and signs of ASCII \
                 without blanks",
                Purpose::LONGEST_PROGRAMME
            );
            self.report(error(Check::Schema, at, Some(KEY), what).right("write it as your proposal has it"));
            return None;
        }
        Some(text.to_owned())
    }

    fn time(&mut self, key: &'static str) -> Option<Utc> {
        let text = self.text(key)?;
        match text.parse() {
            Ok(time) => Some(time),
            Err(bad) => {
                let bad: units::BadTime = bad;
                let other = times::read(text);
                if let Some(Read { utc, is_ambiguous: false }) = other {
                    return Some(utc);
                }
                if let Some(Read { utc, .. }) = other {
                    let at = self.written.field(key);
                    let found =
                        error(Check::Time, at, Some(key), format!("{text:?}: day and month can be either way round"));
                    self.report(found.right(format!("write it as {}, if the month comes first", when(utc))));
                    return None;
                }
                self.report(error(Check::Time, self.written.field(key), Some(key), bad.to_string()));
                None
            }
        }
    }

    /// The action, or the one that was meant, with its parameters; `defaults` are those of the camera, by action.
    fn action(&mut self, defaults: Option<&BTreeMap<String, Map<String, Value>>>) -> Option<Arc<Action>> {
        let name = self.text("action_type")?;
        let named = |name: &str| ACTIONS.iter().find(|entry| entry.name == name);
        let entry = match named(name) {
            Some(entry) => entry,
            None => {
                let at = self.written.field("action_type");
                let found = error(Check::Schema, at, Some("action_type"), format!("unknown action_type {name:?}"));
                let known = ACTIONS.iter().map(|entry| entry.name);
                let fix = self.written.mend(Of::Row, "action_type", Mend::word(name, known.clone()));
                self.report(found.right(meant(name, known.clone())).fix(fix));
                named(nearest(name, known)?)?
            }
        };
        let object = self.object;
        let defaults = defaults.and_then(|of_camera| of_camera.get(entry.name));
        match object.get("action_value") {
            None | Some(Value::Null) => self.parameters(entry, whole(Map::new(), defaults)),
            Some(Value::Object(value)) => self.parameters(entry, whole(value.clone(), defaults)),
            Some(other) => {
                let at = self.written.field("action_value");
                let what = format!("expected an object, found {}", short(other));
                self.report(error(Check::Schema, at, Some("action_value"), what));
                None
            }
        }
    }

    /// Reads the parameters again with each one that is wrong as it is surely meant, else as in the action's example or
    /// without it, so that all are found.
    fn parameters(&mut self, entry: &Entry, mut value: Map<String, Value>) -> Option<Arc<Action>> {
        let (mut mended, mut is_sure): (Vec<String>, bool) = (Vec::new(), true);
        loop {
            let wrong = match entry.read(Value::Object(value.clone())) {
                Ok(action) => return is_sure.then(|| Arc::new(action)),
                Err(wrong) => wrong,
            };
            let few = value.len() <= MOST_PARAMETERS;
            let found = || if few { culprit(entry, &value, &wrong) } else { None };
            let field = wrong.field.clone().or_else(|| missing(&wrong.what)).or_else(found);
            let is_unknown = wrong.what.starts_with(UNKNOWN);
            let is_about = |name: &String| field.as_ref() == Some(name) || (!is_unknown && mentions(&wrong.what, name));
            if mended.iter().any(is_about) {
                // It may not be wrong next to the value that belonged there.
                return None;
            }
            let at = self.place(&wrong, field.as_deref());
            let what = match &field {
                Some(_) => wrong.what,
                None => format!("{}: {}", entry.name, wrong.what),
            };
            let found = error(Check::Schema, at, field.as_deref(), what);
            let given = field.as_ref().and_then(|field| value.get(field)).and_then(Value::as_str);
            let bare = field.as_deref().zip(given).and_then(|(field, given)| unquoted(entry, field, given));
            let (hint, without) = bare.unzip();
            let found = match hint {
                Some(hint) => found.right(hint),
                None => found,
            };
            let mend = wrong.mend.or(without.flatten());
            let mend = field.as_deref().and_then(|field| mend.filter(|mend| takes(entry, field, mend)));
            let fix = field.as_deref().and_then(|field| self.written.mend(Of::Parameters, field, mend.clone()));
            self.report(found.fix(fix));
            let name = field.filter(|_| few && mended.len() < MOST_WRONG)?;
            match mend {
                Some(Mend::Value(text)) => {
                    // The bound that is next to a number beyond it is a guess, and nothing follows from it.
                    is_sure &= !value.get(&name).is_some_and(Value::is_number);
                    value.insert(name.clone(), serde_json::from_str(&text).unwrap_or_default());
                }
                Some(Mend::Name(other)) if !value.contains_key(&other) => {
                    let given = value.remove(&name).unwrap_or_default();
                    self.written.rename(Of::Parameters, &name, &other);
                    value.insert(other, given);
                }
                Some(Mend::Remove) => drop(value.remove(&name)),
                Some(Mend::Name(_)) | None => {
                    is_sure = false;
                    match example(entry).remove(&name) {
                        Some(good) => drop(value.insert(name.clone(), good)),
                        None => drop(value.remove(&name)),
                    }
                }
            }
            mended.push(name);
        }
    }

    /// An unknown parameter's name, a wrong one's value.
    fn place(&self, wrong: &Wrong, field: Option<&str>) -> Position {
        match field {
            None => self.written.field("action_value"),
            Some(name) if wrong.what.starts_with(UNKNOWN) => self.written.parameter_key(name),
            Some(name) => self.written.parameter(name),
        }
    }
}

/// A text where none belongs, a number or a truth value in quotes or an angle of three parts: what is right, and what
/// mends it.
fn unquoted(entry: &Entry, field: &str, given: &str) -> Option<(String, Option<Mend>)> {
    if let Ok(flag) = given.trim().to_ascii_lowercase().parse::<bool>() {
        let mend = Mend::Value(flag.to_string());
        return takes(entry, field, &mend).then(|| (format!("leave the quotes away: {flag}"), Some(mend)));
    }
    if let Some(number) = given.trim().parse::<f64>().ok().filter(|number| number.is_finite()) {
        return Some((format!("leave the quotes away: {number}"), Some(Mend::Value(number.to_string()))));
    }
    let degrees = config::sexagesimal(given)?;
    let (text, of_hours) = (format!("{degrees:.5}"), 15.0 * degrees);
    let may_be_hours = field == "ra" && !given.contains(['d', '\u{b0}']);
    let words = match field {
        "ra" if may_be_hours => {
            format!("ra is in degrees: {of_hours:.5} if these are hours, {text} if they are degrees")
        }
        "ra" => format!("in degrees that is {text}"),
        "dec" | "alt" | "az" => format!("{field} is in degrees: {text}"),
        _ => return None,
    };
    Some((words, (!may_be_hours).then_some(Mend::Value(text))))
}

/// Does an action take a parameter with its new value? Another name is looked at when it stands there.
fn takes(entry: &Entry, name: &str, mend: &Mend) -> bool {
    let Mend::Value(text) = mend else { return true };
    let mut value = example(entry);
    value.insert(name.to_owned(), serde_json::from_str(text).unwrap_or_default());
    entry.read(Value::Object(value)).err().is_none_or(|wrong| wrong.field.as_deref() != Some(name))
}

/// Parameters that are valid, as a test proves.
fn example(entry: &Entry) -> Map<String, Value> {
    serde_json::from_str(entry.example).unwrap_or_default()
}

/// Is a parameter named in a message?
fn mentions(what: &str, name: &str) -> bool {
    what.split(|c: char| !c.is_alphanumeric() && c != '_').any(|word| word == name)
}

/// The name in serde's "missing field `x`".
fn missing(what: &str) -> Option<String> {
    what.strip_prefix("missing field `")?.split('`').next().map(str::to_owned)
}

/// The parameter that is wrong in this way also by itself.
fn culprit(entry: &Entry, value: &Map<String, Value>, wrong: &Wrong) -> Option<String> {
    value.iter().take(MOST_PARAMETERS).find_map(|(name, value)| {
        let alone = entry.read(Value::Object(Map::from_iter([(name.clone(), value.clone())]))).err();
        (alone.as_ref() == Some(wrong)).then(|| name.clone())
    })
}

/// A value in a message.
fn short(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{} ...", text.get(..end).unwrap_or_default()),
        None => text,
    }
}

/// An instant as people read it, to the second.
pub(super) fn when(at: Utc) -> String {
    at.strftime("%Y-%m-%dT%H:%M:%SZ")
}
