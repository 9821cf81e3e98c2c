//! Templates in Jinja2, rendered by `minijinja`, with the few methods of Python that names are made with.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use minijinja::value::{Kwargs, Object, ObjectRepr, Value as Jinja, from_args};
use minijinja::{Environment, Error, ErrorKind, State, UndefinedBehavior};
use units::Utc;

use super::{TemplateValue, Values, format};

/// Renders a template; what is undefined is an error.
pub(super) fn render(template: &str, values: &Values) -> Result<String, String> {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.set_unknown_method_callback(method);
    environment.add_filter("format", percent);
    let context: BTreeMap<&str, Jinja> = values.iter().map(|(name, value)| (*name, to_jinja(value))).collect();
    environment.render_str(&with_methods(template), context).map_err(|error| error.to_string())
}

/// Python's arithmetic of dates, which Jinja has only in Python, as calls: `date + datetime.timedelta(hours=5)` becomes
/// `date.plus(hours=5)`, and `-` becomes `.minus`.
fn with_methods(template: &str) -> String {
    const DELTA: &str = "datetime.timedelta(";
    let mut out = String::new();
    let mut rest = template;
    while let Some(at) = rest.find(DELTA) {
        let before = rest[..at].trim_end();
        let date = before.strip_suffix(['+', '-']).map(str::trim_end);
        match date {
            Some(date) => {
                out.push_str(date);
                out.push_str(if before.ends_with('+') { ".plus(" } else { ".minus(" });
            }
            None => out.push_str(&rest[..at + DELTA.len()]),
        }
        rest = &rest[at + DELTA.len()..];
    }
    out + rest
}

fn to_jinja(value: &TemplateValue) -> Jinja {
    match value {
        TemplateValue::Text(text) => Jinja::from(text.as_str()),
        TemplateValue::Int(number) => Jinja::from(*number),
        TemplateValue::Float(number) => Jinja::from(*number),
        TemplateValue::Date(date) => Jinja::from_object(Date(*date)),
    }
}

/// A date with `strftime`, `isoformat`, `plus(days=…, hours=…)`, `minus(…)` and its parts.
#[derive(Debug)]
struct Date(Utc);

impl Object for Date {
    fn repr(self: &Arc<Self>) -> ObjectRepr {
        ObjectRepr::Plain
    }

    fn get_value(self: &Arc<Self>, key: &Jinja) -> Option<Jinja> {
        let directive = match key.as_str()? {
            "year" => "%Y",
            "month" => "%m",
            "day" => "%d",
            "hour" => "%H",
            "minute" => "%M",
            "second" => "%S",
            "microsecond" => "%6f",
            _ => return None,
        };
        self.0.strftime(directive).parse::<i64>().ok().map(Jinja::from)
    }

    fn call_method(self: &Arc<Self>, _: &mut State<'_, '_>, method: &str, args: &[Jinja]) -> Result<Jinja, Error> {
        match method {
            "strftime" => {
                let (pattern,): (&str,) = from_args(args)?;
                let text = format::strftime(self.0, pattern);
                text.map(Jinja::from).map_err(|fault| Error::new(ErrorKind::InvalidOperation, fault))
            }
            "isoformat" => Ok(Jinja::from(self.0.strftime("%Y-%m-%dT%H:%M:%S.%6f"))),
            "plus" => Ok(Jinja::from_object(Self(self.0.plus_seconds(delta_s(args)?)))),
            "minus" => Ok(Jinja::from_object(Self(self.0.plus_seconds(-delta_s(args)?)))),
            _ => Err(unknown(method)),
        }
    }

    fn render(self: &Arc<Self>, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.strftime("%Y-%m-%d %H:%M:%S.%6f"))
    }
}

/// The arguments of Python's `timedelta`, s: by name, or days as the only one without.
fn delta_s(args: &[Jinja]) -> Result<f64, Error> {
    const LENGTHS: [(&str, f64); 7] = [
        ("weeks", 604_800.0),
        ("days", 86_400.0),
        ("hours", 3600.0),
        ("minutes", 60.0),
        ("seconds", 1.0),
        ("milliseconds", 1e-3),
        ("microseconds", 1e-6),
    ];
    let (days, parts): (Option<f64>, Kwargs) = from_args(args)?;
    let mut seconds = days.unwrap_or(0.0) * 86_400.0;
    for (name, length_s) in LENGTHS {
        seconds += parts.get::<Option<f64>>(name)?.unwrap_or(0.0) * length_s;
    }
    parts.assert_all_used()?;
    Ok(seconds)
}

/// Methods of texts and numbers.
fn method(_: &mut State<'_, '_>, value: &Jinja, method: &str, args: &[Jinja]) -> Result<Jinja, Error> {
    let Some(text) = value.as_str() else { return Err(unknown(method)) };
    Ok(match method {
        "upper" => Jinja::from(text.to_uppercase()),
        "lower" => Jinja::from(text.to_lowercase()),
        "strip" => Jinja::from(text.trim()),
        "replace" => {
            let (old, new): (&str, &str) = from_args(args)?;
            Jinja::from(text.replace(old, new))
        }
        "startswith" => {
            let (start,): (&str,) = from_args(args)?;
            Jinja::from(text.starts_with(start))
        }
        "format" => Jinja::from(braces(text, args)?),
        _ => return Err(unknown(method)),
    })
}

/// `'{:.3f}'.format(exptime)`: fields in order.
fn braces(template: &str, args: &[Jinja]) -> Result<String, Error> {
    let mut out = String::new();
    let (mut rest, mut args) = (template, args.iter());
    while let Some((before, after)) = rest.split_once('{') {
        let (spec, after) = after.split_once('}').ok_or_else(|| bad("a brace stands alone"))?;
        let value = args.next().ok_or_else(|| bad("more fields than values"))?;
        out.push_str(before);
        out.push_str(&with_spec(value, spec.trim_start_matches(':'))?);
        rest = after;
    }
    Ok(out + rest)
}

/// `'%.3f' | format(exptime)`: one field.
fn percent(template: &str, value: &Jinja) -> Result<String, Error> {
    let (before, field) = template.split_once('%').ok_or_else(|| bad("no % in the format"))?;
    let end = field.find(|c: char| c.is_ascii_alphabetic()).ok_or_else(|| bad("no type in the format"))? + 1;
    let spec = field[..end].trim_start_matches('-');
    let spec = if spec.ends_with('s') && value.as_str().is_none() { &spec[..spec.len() - 1] } else { spec };
    Ok(format!("{before}{}{}", with_spec(value, spec)?, &field[end..]))
}

fn with_spec(value: &Jinja, spec: &str) -> Result<String, Error> {
    let value = match (value.as_str(), i64::try_from(value.clone()), f64::try_from(value.clone())) {
        (Some(text), ..) => TemplateValue::Text(text.to_owned()),
        (None, Ok(number), _) if value.is_integer() => TemplateValue::Int(number),
        (None, _, Ok(number)) => TemplateValue::Float(number),
        _ => TemplateValue::Text(value.to_string()),
    };
    format::format(&value, spec).map_err(|fault| Error::new(ErrorKind::InvalidOperation, fault))
}

fn unknown(method: &str) -> Error {
    Error::new(ErrorKind::UnknownMethod, format!("no method {method:?} in file names"))
}

fn bad(fault: &'static str) -> Error {
    Error::new(ErrorKind::InvalidOperation, fault)
}
