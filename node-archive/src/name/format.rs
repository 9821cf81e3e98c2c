//! Format specifications as Python has them (`.3f`, `03d`, `%Y%m%d`), for one value.

use super::TemplateValue;

/// A specification, read.
#[derive(Debug, Default)]
struct Spec {
    fill: Option<char>,
    align: Option<char>,
    plus: Option<char>,
    zero: bool,
    width: usize,
    grouping: Option<char>,
    precision: Option<usize>,
    kind: Option<char>,
}

/// Widest field and finest precision; a name has no use for more.
const LIMIT: usize = 64;
/// Directives of a date; others differ between systems or have no place in a name.
const DIRECTIVES: &str = "YmdHMSfjybBaApI%";

/// Writes a value by a specification, which may be empty; the error says what is wrong with it.
pub(super) fn format(value: &TemplateValue, spec: &str) -> Result<String, String> {
    if let TemplateValue::Date(date) = value {
        return if spec.is_empty() { strftime(*date, "%Y-%m-%d %H:%M:%S.%f") } else { strftime(*date, spec) };
    }
    let spec = Spec::read(spec)?;
    let (body, is_number) = match value {
        TemplateValue::Text(text) => (spec.text(text)?, false),
        TemplateValue::Int(number) => (spec.int(*number)?, true),
        TemplateValue::Float(number) => (spec.float(*number)?, true),
        TemplateValue::Date(_) => return Err("a date takes a strftime pattern".to_owned()),
    };
    Ok(spec.pad(&body, is_number))
}

/// Writes a date; `%f` is microseconds as in Python.
pub(super) fn strftime(date: units::Utc, pattern: &str) -> Result<String, String> {
    let mut letters = pattern.chars();
    while let Some(letter) = letters.next() {
        if letter == '%' && !letters.next().is_some_and(|directive| DIRECTIVES.contains(directive)) {
            return Err(format!("date pattern {pattern:?}: expected only %{}", DIRECTIVES.replace("", " %").trim()));
        }
    }
    // So that it differs from a literal %% that an f follows.
    let pattern = pattern.replace("%%", "\u{1}").replace("%f", "%6f").replace('\u{1}', "%%");
    Ok(date.strftime(&pattern))
}

impl Spec {
    fn read(text: &str) -> Result<Self, String> {
        let bad = || format!("format {text:?}: expected [[fill]align][sign][0][width][,][.precision][type]");
        let mut spec = Self::default();
        let mut rest: &[char] = &text.chars().collect::<Vec<_>>();
        match rest {
            [fill, align @ ('<' | '>' | '^' | '='), ..] => {
                (spec.fill, spec.align) = (Some(*fill), Some(*align));
                rest = &rest[2..];
            }
            [align @ ('<' | '>' | '^' | '='), ..] => {
                spec.align = Some(*align);
                rest = &rest[1..];
            }
            _ => {}
        }
        if let [sign @ ('+' | '-' | ' '), ..] = rest {
            spec.plus = (*sign != '-').then_some(*sign);
            rest = &rest[1..];
        }
        if let ['0', ..] = rest {
            spec.zero = true;
            rest = &rest[1..];
        }
        spec.width = number(&mut rest).unwrap_or(0);
        if let [grouping @ (',' | '_'), ..] = rest {
            spec.grouping = Some(*grouping);
            rest = &rest[1..];
        }
        if let ['.', ..] = rest {
            rest = &rest[1..];
            spec.precision = Some(number(&mut rest).ok_or_else(bad)?);
        }
        if let [kind, ..] = rest {
            spec.kind = Some(*kind);
            rest = &rest[1..];
        }
        let too_wide = spec.width > LIMIT || spec.precision.is_some_and(|precision| precision > LIMIT);
        if rest.is_empty() && !too_wide { Ok(spec) } else { Err(bad()) }
    }

    fn text(&self, text: &str) -> Result<String, String> {
        if self.kind.is_some_and(|kind| kind != 's') || self.plus.is_some() || self.grouping.is_some() {
            return Err("a text takes only fill, align, width, .precision and s".to_owned());
        }
        Ok(text.chars().take(self.precision.unwrap_or(usize::MAX)).collect())
    }

    fn int(&self, number: i64) -> Result<String, String> {
        match self.kind {
            None | Some('d') if self.precision.is_none() => {
                Ok(self.signed(number < 0, number.unsigned_abs().to_string()))
            }
            Some('x') => Ok(self.signed(number < 0, format!("{:x}", number.unsigned_abs()))),
            Some('f' | 'F' | 'e' | 'E' | 'g' | 'G' | '%') => self.float(number as f64),
            _ => Err("a whole number takes d, x, f, e, g or %".to_owned()),
        }
    }

    fn float(&self, number: f64) -> Result<String, String> {
        let (size, precision) = (number.abs(), self.precision.unwrap_or(6));
        let digits = match self.kind {
            Some('f' | 'F') => format!("{size:.precision$}"),
            Some('e' | 'E') => exponent(size, precision),
            Some('%') => format!("{:.precision$}%", size * 100.0),
            Some('g' | 'G') => general(size, precision.max(1)),
            None => match self.precision {
                Some(precision) => general(size, precision.max(1)),
                None => format!("{size:?}"),
            },
            Some(_) => return Err("a number takes f, e, g or %".to_owned()),
        };
        let digits = if self.kind.is_some_and(char::is_uppercase) { digits.to_uppercase() } else { digits };
        Ok(self.signed(number < 0.0, digits))
    }

    fn signed(&self, negative: bool, digits: String) -> String {
        let digits = match self.grouping {
            Some(mark) => grouped(&digits, mark),
            None => digits,
        };
        match (negative, self.plus) {
            (true, _) => format!("-{digits}"),
            (false, Some(sign)) => format!("{sign}{digits}"),
            (false, None) => digits,
        }
    }

    fn pad(&self, body: &str, is_number: bool) -> String {
        let missing = self.width.saturating_sub(body.chars().count());
        let zeros = self.zero && is_number && self.align.is_none();
        let fill = |count: usize| {
            let fill = self.fill.unwrap_or(if self.zero { '0' } else { ' ' });
            std::iter::repeat_n(fill, count).collect::<String>()
        };
        let align = if zeros { '=' } else { self.align.unwrap_or(if is_number { '>' } else { '<' }) };
        match align {
            '<' => format!("{body}{}", fill(missing)),
            '^' => format!("{}{body}{}", fill(missing / 2), fill(missing - missing / 2)),
            '=' => {
                let sign = body.len() - body.trim_start_matches(['+', '-', ' ']).len();
                format!("{}{}{}", &body[..sign], fill(missing), &body[sign..])
            }
            _ => format!("{}{body}", fill(missing)),
        }
    }
}

fn number(rest: &mut &[char]) -> Option<usize> {
    let count = rest.iter().take_while(|c| c.is_ascii_digit()).count();
    let digits: String = rest[..count].iter().collect();
    *rest = &rest[count..];
    digits.parse().ok()
}

/// Python's `e`: at least two digits of exponent, with a sign.
fn exponent(size: f64, precision: usize) -> String {
    let text = format!("{size:.precision$e}");
    match text.split_once('e') {
        Some((mantissa, power)) => {
            let power: i32 = power.parse().unwrap_or(0);
            format!("{mantissa}e{}{:02}", if power < 0 { '-' } else { '+' }, power.abs())
        }
        None => text,
    }
}

/// Python's `g`: so many significant digits, trailing zeros gone.
fn general(size: f64, digits: usize) -> String {
    let scientific = format!("{size:.*e}", digits - 1);
    let power: i32 = scientific.split_once('e').and_then(|(_, power)| power.parse().ok()).unwrap_or(0);
    let trim = |text: String| match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    };
    if (-4..digits as i32).contains(&power) {
        trim(format!("{size:.*}", (digits as i32 - 1 - power).max(0) as usize))
    } else {
        let text = exponent(size, digits - 1);
        match text.split_once('e') {
            Some((mantissa, power)) => format!("{}e{power}", trim(mantissa.to_owned())),
            None => text,
        }
    }
}

fn grouped(digits: &str, mark: char) -> String {
    let (whole, rest) = digits.split_at(digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len()));
    let mut out = String::new();
    for (i, digit) in whole.chars().enumerate() {
        if i > 0 && (whole.len() - i) % 3 == 0 {
            out.push(mark);
        }
        out.push(digit);
    }
    out + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_agree_with_python() {
        let float = |number: f64, spec: &str| format(&TemplateValue::Float(number), spec).unwrap();
        let int = |number: i64, spec: &str| format(&TemplateValue::Int(number), spec).unwrap();
        let text = |text: &str, spec: &str| format(&TemplateValue::Text(text.to_owned()), spec).unwrap();
        // Each right-hand side is what CPython 3.11 prints.
        for (got, expected) in [
            (float(30.0, ".3f"), "30.000"),
            (float(0.0015, ".3f"), "0.002"),
            (float(30.0, ""), "30.0"),
            (float(30.0, "g"), "30"),
            (float(0.5, "08.2f"), "00000.50"),
            (float(-0.5, "08.2f"), "-0000.50"),
            (float(1234567.0, ",.1f"), "1,234,567.0"),
            (float(1e-7, ".2e"), "1.00e-07"),
            (float(1e-7, "g"), "1e-07"),
            (float(123456789.0, "g"), "1.23457e+08"),
            (float(0.25, ".0%"), "25%"),
            (float(2.5, "+.1f"), "+2.5"),
            (int(7, "04d"), "0007"),
            (int(-7, "04"), "-007"),
            (int(7, ""), "7"),
            (int(7, ".1f"), "7.0"),
            (int(7, "*^5"), "**7**"),
            (text("ab", ">4"), "  ab"),
            (text("abcdef", ".3"), "abc"),
            (text("ab", "_<4s"), "ab__"),
        ] {
            assert_eq!(got, expected);
        }
    }

    #[test]
    fn dates_take_strftime() {
        let date = TemplateValue::Date("2026-11-21T03:00:01.5Z".parse().unwrap());
        assert_eq!(format(&date, "%Y%m%d_%H%M%S.%f").unwrap(), "20261121_030001.500000");
        assert_eq!(format(&date, "%j%%f").unwrap(), "325%f");
        assert_eq!(format(&date, "").unwrap(), "2026-11-21 03:00:01.500000");
        for bad in ["%Q", "%", "%Y%"] {
            assert!(format(&date, bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn what_python_refuses_is_refused() {
        for (value, spec) in [
            (TemplateValue::Text("a".into()), "d"),
            (TemplateValue::Text("a".into()), ".3f"),
            (TemplateValue::Int(1), ".3d"),
            (TemplateValue::Float(1.0), "d"),
            (TemplateValue::Float(1.0), ".f"),
            (TemplateValue::Float(1.0), "3q3"),
            (TemplateValue::Float(1.0), "999999999f"),
        ] {
            assert!(format(&value, spec).is_err(), "{value:?} {spec}");
        }
    }
}
