//! File names, written by a site's templates: Python format fields or Jinja2.
//!
//! Values come from schedules, which any person may write, so each is cleaned before it is written into a name, and the
//! finished name is checked again: it never leaves the folder. Every template is tried once at the start.

mod format;
mod jinja;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use config::FileProfile;
use contract::device::camera::Frame;
use sky::NightDate;
use units::{Angle, Utc};

/// Action types that may have a template of their own, and the templates of those who have none: the predecessor's, and
/// ours. Ours are plain words, without blanks and dots, and begin with the start of the exposure: sorted by name they are
/// sorted by time, and archives take what is behind the only dot for the type of the file.
const DEFAULTS: [(&str, &str, &str); 7] = [
    (
        "object",
        "{action_date}/{device}_{filter_name}_{object_name}_{exptime:.3f}_{timestamp}.fits",
        "{action_date}/{start}_{camera}_{imagetype}_{object}_{filter}_{exposure}.fits",
    ),
    (
        "calibration",
        "{action_date}/{device}_{imagetype}_{exptime:.3f}_{timestamp}.fits",
        "{action_date}/{start}_{camera}_{imagetype}_{exposure}.fits",
    ),
    (
        "flats",
        "{action_date}/{device}_{filter_name}_{imagetype}_{exptime:.3f}_{timestamp}.fits",
        "{action_date}/{start}_{camera}_{imagetype}_{filter}_{exposure}.fits",
    ),
    (
        "autofocus",
        "autofocus/{action_date}/{device}_{filter_name}_{imagetype}_{exptime:.3f}_{timestamp}.fits",
        "autofocus/{action_date}/{start}_{camera}_{imagetype}_{filter}_{exposure}.fits",
    ),
    (
        "calibrate_guiding",
        "calibrate_guiding/{action_date}/{device}_{filter_name}_{imagetype}_{exptime:.3f}_{timestamp}.fits",
        "calibrate_guiding/{action_date}/{start}_{camera}_{imagetype}_{filter}_{exposure}.fits",
    ),
    (
        "pointing_model",
        "pointing_model/{action_date}/{device}_{filter_name}_{imagetype}_{exptime:.3f}_{timestamp}.fits",
        "pointing_model/{action_date}/{start}_{camera}_{imagetype}_{filter}_{exposure}.fits",
    ),
    (
        "default",
        "{action_date}/{device}_{filter_name}_{imagetype}_{exptime:.3f}_{timestamp}.fits",
        "{action_date}/{start}_{camera}_{imagetype}_{object}_{filter}_{exposure}.fits",
    ),
];

/// The default templates of a profile.
fn defaults(profile: FileProfile) -> impl Iterator<Item = (&'static str, &'static str)> {
    DEFAULTS.iter().map(move |(action, astra, plain)| match profile {
        FileProfile::Astra => (*action, *astra),
        FileProfile::Plain => (*action, *plain),
    })
}

/// What the name of a file with compressed tiles ends with, behind its other ending.
pub const COMPRESSED: &str = ".fz";

/// The path of a file, where its image is compressed.
pub fn compressed(mut path: PathBuf) -> PathBuf {
    if !path.to_string_lossy().ends_with(COMPRESSED) {
        path.as_mut_os_string().push(COMPRESSED);
    }
    path
}

/// Longest part of a path, bytes; file systems take 255, and a collision adds a stamp.
const LONGEST_PART: usize = 180;

/// A template that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("archive.filename.{action}: {fault} in {template:?}")]
pub struct NameError {
    /// Whose template it is.
    pub action: String,
    template: String,
    fault: String,
}

/// A value that a template may use.
#[derive(Debug, Clone, PartialEq)]
enum TemplateValue {
    Text(String),
    Int(i64),
    Float(f64),
    Date(Utc),
}

type Values = BTreeMap<&'static str, TemplateValue>;

/// Names files.
pub struct Namer {
    /// Template and whether it is Jinja, by action type.
    templates: BTreeMap<String, (String, bool)>,
    profile: FileProfile,
    longitude_east: Angle,
}

impl Namer {
    /// A namer with a site's own templates in place of the defaults; each is tried once.
    ///
    /// # Errors
    /// The first template that cannot be used.
    pub fn new(own: &BTreeMap<String, String>, profile: FileProfile, longitude_deg: f64) -> Result<Self, NameError> {
        let (namer, mut faults) = Self::with_faults(own, profile, longitude_deg);
        if faults.is_empty() { Ok(namer) } else { Err(faults.swap_remove(0)) }
    }

    /// As [`Namer::new`], with the default in the place of each template that cannot be used, and what is wrong with
    /// those.
    pub fn with_faults(
        own: &BTreeMap<String, String>,
        profile: FileProfile,
        longitude_deg: f64,
    ) -> (Self, Vec<NameError>) {
        // One Jinja template makes all of a site's own Jinja, as the predecessor reads them.
        let is_jinja = own.values().any(|template| template.contains("{{") && template.contains("}}"));
        let mut templates: BTreeMap<String, (String, bool)> =
            defaults(profile).map(|(action, template)| (action.to_owned(), (template.to_owned(), false))).collect();
        for (action, template) in own {
            match templates.get_mut(action) {
                Some(place) => *place = (template.clone(), is_jinja),
                None => tracing::warn!(action, "archive.filename: no frames are named by this; it is not used"),
            }
        }
        let mut namer = Self { templates, profile, longitude_east: Angle::from_degrees(longitude_deg) };
        let mut faults = Vec::new();
        for (action, default) in defaults(profile) {
            if let Err(fault) = namer.render(action, &trial()) {
                let before = namer.templates.insert(action.to_owned(), (default.to_owned(), false));
                let template = before.map(|(template, _)| template).unwrap_or_default();
                faults.push(NameError { action: action.to_owned(), template, fault });
            }
        }
        (namer, faults)
    }

    /// The path of a frame's file, relative to the folder of images: folders and name, none of them leading out.
    pub fn path(&self, frame: &Frame, written: Utc) -> PathBuf {
        let action = frame.purpose.action.as_str();
        let values = self.values(frame, written);
        let rendered = self.render(action, &values).unwrap_or_else(|fault| {
            tracing::warn!(%fault, action, "the file name template failed; the default is used");
            let template = defaults(self.profile).last().map_or("", |(_, template)| template);
            plain(template, &values).unwrap_or_else(|_| format!("{}.fits", frame.id))
        });
        let mut path = folder(frame.purpose.folder.as_deref());
        path.extend(rendered.split('/').filter(|part| !part.is_empty()).map(part));
        path
    }

    /// Renders the template of an action; names of devices and objects are cleaned already, the result is not.
    fn render(&self, action: &str, values: &Values) -> Result<String, String> {
        let (template, is_jinja) = self
            .templates
            .get(action)
            .or_else(|| self.templates.get("default"))
            .ok_or_else(|| "no default template".to_owned())?;
        let rendered = if *is_jinja { jinja::render(template, values)? } else { plain(template, values)? };
        if rendered.starts_with('/') || rendered.contains('\\') || rendered.contains(':') {
            return Err(format!("{rendered:?} is no relative path"));
        }
        if rendered.split('/').any(|part| part == "..") {
            return Err(format!("{rendered:?} leads out of the folder"));
        }
        if rendered.is_empty() || rendered.ends_with('/') {
            return Err(format!("{rendered:?} ends without a file name"));
        }
        Ok(rendered)
    }

    fn values(&self, frame: &Frame, written: Utc) -> Values {
        let purpose = &frame.purpose;
        let night = purpose.night.parse().unwrap_or_else(|_| sky::night_date(self.longitude_east, frame.started_utc));
        let named = |name: Option<&String>| {
            let name =
                name.map(|name| clean(&name.replace('\'', ""))).filter(|name| !name.trim_matches('.').is_empty());
            TemplateValue::Text(name.unwrap_or_else(|| "NA".to_owned()))
        };
        values(Fields {
            action: clean(&purpose.action),
            device: clean(&frame.camera),
            filter: named(purpose.filter.as_ref()),
            object: named(purpose.object.as_ref()),
            image_type: image_type(&purpose.image_type),
            exposure_s: frame.exposure_s,
            sequence: purpose.sequence,
            night,
            started: frame.started_utc,
            written,
        })
    }
}

struct Fields {
    action: String,
    device: String,
    filter: TemplateValue,
    object: TemplateValue,
    image_type: &'static str,
    exposure_s: f64,
    sequence: u32,
    night: NightDate,
    started: Utc,
    written: Utc,
}

fn values(fields: Fields) -> Values {
    let date = fields.night.to_string();
    let (year, month, day) = fields.night.ymd();
    let midnight = format!("{year:04}-{month:02}-{day:02}T00:00:00Z").parse().unwrap_or(Utc::EPOCH);
    let as_word = |value: &TemplateValue| match value {
        TemplateValue::Text(text) => TemplateValue::Text(word(text)),
        other => other.clone(),
    };
    BTreeMap::from([
        ("camera", TemplateValue::Text(word(&fields.device))),
        ("filter", as_word(&fields.filter)),
        ("object", as_word(&fields.object)),
        ("exposure", TemplateValue::Text(exposure_word(fields.exposure_s))),
        ("start", TemplateValue::Text(fields.started.strftime("%Y%m%dT%H%M%S-%3f"))),
        ("action_type", TemplateValue::Text(fields.action)),
        ("device", TemplateValue::Text(fields.device)),
        ("filter_name", fields.filter),
        ("object_name", fields.object),
        ("imagetype", TemplateValue::Text(fields.image_type.to_owned())),
        ("exptime", TemplateValue::Float(fields.exposure_s)),
        ("timestamp", TemplateValue::Text(fields.written.strftime("%Y%m%d_%H%M%S.%3f"))),
        ("datetime_timestamp", TemplateValue::Date(fields.written)),
        ("action_date", TemplateValue::Text(date)),
        ("action_datetime", TemplateValue::Date(midnight)),
        ("sequence_counter", TemplateValue::Int(fields.sequence.into())),
    ])
}

fn trial() -> Values {
    let written = Utc::from_micros(1_795_230_000_500_000);
    values(Fields {
        action: "object".to_owned(),
        device: "camera".to_owned(),
        filter: TemplateValue::Text("Clear".to_owned()),
        object: TemplateValue::Text("Object".to_owned()),
        image_type: "light",
        exposure_s: 1.5,
        sequence: 0,
        night: sky::night_date(Angle::from_degrees(0.0), written),
        started: written,
        written,
    })
}

/// `Light Frame` becomes `light`.
fn image_type(text: &str) -> &'static str {
    let text = text.to_lowercase();
    ["light", "bias", "dark", "flat", "acquisition", "test"]
        .into_iter()
        .find(|word| text.contains(word))
        .unwrap_or("default")
}

/// A text as one word of a name: letters, digits, `+` and `-`, which need no quotes anywhere.
fn word(text: &str) -> String {
    let harmless = |c: char| c.is_ascii_alphanumeric() || "+-".contains(c);
    let parts: Vec<String> = text
        .split(|c: char| !harmless(c))
        .map(|part| part.trim_matches('-').to_owned())
        .filter(|part| !part.is_empty())
        .collect();
    if parts.is_empty() { "NA".to_owned() } else { parts.join("-") }
}

/// An exposure time without a dot: `120s`, `1500ms`, `250us`. It is rounded to 10 ms from 1 s on, to 0.1 ms from 1 ms on:
/// cameras report what they counted, such as 119.99987 s.
fn exposure_word(exposure_s: f64) -> String {
    let step_us = if exposure_s < 0.001 {
        1.0
    } else if exposure_s < 1.0 {
        100.0
    } else {
        10_000.0
    };
    let microseconds = (exposure_s * 1e6 / step_us).round() * step_us;
    if !(0.0..1e15).contains(&microseconds) {
        return "NA".to_owned();
    }
    match microseconds as u64 {
        whole if whole % 1_000_000 == 0 => format!("{}s", whole / 1_000_000),
        whole if whole % 1000 == 0 => format!("{}ms", whole / 1000),
        whole => format!("{whole}us"),
    }
}

/// Renders `{name:format}` fields; `{{` and `}}` are braces.
fn plain(template: &str, values: &Values) -> Result<String, String> {
    let mut out = String::new();
    let mut rest = template;
    while let Some(brace) = rest.find(['{', '}']) {
        out.push_str(&rest[..brace]);
        let from = &rest[brace..];
        if from.starts_with("{{") || from.starts_with("}}") {
            out.push_str(&from[..1]);
            rest = &from[2..];
            continue;
        }
        let field = from.strip_prefix('{').and_then(|inside| inside.split_once('}'));
        let (field, after) = field.ok_or_else(|| "a brace stands alone".to_owned())?;
        let (name, spec) = field.split_once(':').unwrap_or((field, ""));
        let name = name.trim_end_matches("!s");
        let value = values.get(name).ok_or_else(|| unknown(name, values))?;
        out.push_str(&format::format(value, spec)?);
        rest = after;
    }
    out.push_str(rest);
    Ok(out)
}

fn unknown(name: &str, values: &Values) -> String {
    let known: Vec<&str> = values.keys().copied().collect();
    format!("{name:?} is no variable; expected one of {}", known.join(", "))
}

/// An action's own folder, relative to the folder of images; one that would lead out of it is not used.
fn folder(own: Option<&str>) -> PathBuf {
    let Some(own) = own.filter(|own| !own.trim().is_empty()) else { return PathBuf::new() };
    let leads_out =
        own.starts_with(['/', '\\']) || own.contains(':') || own.split(['/', '\\']).any(|part| part == "..");
    if leads_out {
        tracing::warn!(folder = own, "the action's folder is not inside the folder of images; the default is used");
        return PathBuf::new();
    }
    own.split(['/', '\\']).filter(|part| !matches!(*part, "" | ".")).map(part).collect()
}

/// Text from a schedule as it may stand inside a name: no separators, no control characters, nothing that Windows
/// refuses, and plain ASCII, since cfitsio opens no other names there.
fn clean(text: &str) -> String {
    let harmless = |c: char| c.is_ascii_alphanumeric() || " -_.+()[],=@#~".contains(c);
    text.chars().map(|c| if harmless(c) { c } else { '_' }).collect::<String>().trim().to_owned()
}

/// One folder or file name that every file system takes.
pub(crate) fn part(text: &str) -> String {
    let cleaned = clean(text);
    // Windows drops trailing dots and spaces; leading dots hide a file.
    let cleaned = cleaned.trim_end_matches(['.', ' ']);
    let bare = cleaned.trim_start_matches('.');
    let mut name = if bare.len() < cleaned.len() { format!("_{bare}") } else { cleaned.to_owned() };
    if name.is_empty() {
        name.push('_');
    }
    if name.len() > LONGEST_PART {
        let ending = Path::new(&name).extension().and_then(|ending| ending.to_str()).filter(|e| e.len() <= 8);
        let ending = ending.map(|ending| format!(".{ending}")).unwrap_or_default();
        let mut length = LONGEST_PART - ending.len();
        while !name.is_char_boundary(length) {
            length -= 1;
        }
        name.truncate(length);
        name.push_str(&ending);
    }
    let stem = name.split('.').next().unwrap_or_default().to_ascii_uppercase();
    let reserved = matches!(stem.as_str(), "CON" | "PRN" | "AUX" | "NUL")
        || (stem.len() == 4
            && (stem.starts_with("COM") || stem.starts_with("LPT"))
            && stem.ends_with(char::is_numeric));
    if reserved { format!("_{name}") } else { name }
}

/// The path for a file whose own is taken: the time of writing is added to its name, and a number if need be.
pub fn other_than(taken: &Path, written: Utc) -> PathBuf {
    let name = taken.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let inner = name.strip_suffix(COMPRESSED).unwrap_or(&name);
    let (stem, ending) = name.split_at(inner.rfind('.').filter(|at| *at > 0).unwrap_or(inner.len()));
    let stamp = written.strftime("%Y%m%d_%H%M%S-%6f");
    let mut other = taken.with_file_name(format!("{stem}-v{stamp}{ending}"));
    let mut count = 1;
    while crate::folder::is_taken(&other) {
        count += 1;
        other = taken.with_file_name(format!("{stem}-v{stamp}-{count}{ending}"));
    }
    other
}

#[cfg(test)]
mod tests;
