//! What must hold of the limits on weather and switches.

use contract::device::observing_conditions;

use crate::device::{Limit, Measure, blocks};
use crate::findings::Findings;
use crate::nearest::nearest;
use crate::observatory::Observatory;
use crate::plausible;

/// All limits.
pub(crate) fn prove(observatory: &Observatory, findings: &mut Findings<'_>) {
    for (path, _, station) in blocks(&observatory.observingconditions) {
        for (index, limit) in station.limit.iter().enumerate() {
            weather_limit(limit, &format!("{path}.limit[{index}]"), findings);
        }
    }
    for (index, limit) in observatory.shared.limit.iter().enumerate() {
        weather_limit(limit, &format!("shared.limit[{index}]"), findings);
    }
    for (path, _, switch) in blocks(&observatory.switch) {
        for (index, limit) in switch.limit.iter().enumerate() {
            let path = format!("{path}.limit[{index}]");
            if contract::device::switch::number_of(&limit.parameter).is_none() {
                no_such_parameter(limit, "expected GetSwitchValue0, GetSwitchValue1 and so on", &path, findings);
            }
            possible_holds(limit, &path, findings);
            limit_holds(limit, &path, findings);
        }
    }
}

fn possible_holds(limit: &Limit, path: &str, findings: &mut Findings<'_>) {
    let Some([low, high]) = limit.possible else { return };
    let is_range = low < high && low.is_finite() && high.is_finite();
    if !is_range {
        let name = limit.parameter.as_str();
        let why = "expected the switch's smallest value, then its largest one";
        findings.error(&format!("{path}.possible"), format!("limit on \"{name}\": possible = [{low}, {high}]: {why}"));
    }
}

fn weather_limit(limit: &Limit, path: &str, findings: &mut Findings<'_>) {
    if observing_conditions::made_of(&limit.parameter).is_empty() {
        let near = nearest(&limit.parameter, observing_conditions::parameters());
        let help = near.map(|near| format!("did you mean \"{near}\"?")).unwrap_or_else(|| {
            "expected an ASCOM ObservingConditions property (Humidity, WindSpeed ...), RelativeSkyTemp or DewPointMargin"
                .to_owned()
        });
        no_such_parameter(limit, &help, path, findings);
    }
    if limit.possible.is_some() {
        let name = limit.parameter.as_str();
        let why = "possible is for limits of a switch; which weather is possible is known: leave it out";
        findings.error(&format!("{path}.possible"), format!("limit on \"{name}\": {why}"));
    }
    limit_holds(limit, path, findings);
    plausible::weather(limit, path, findings);
}

fn no_such_parameter(limit: &Limit, help: &str, path: &str, findings: &mut Findings<'_>) {
    let name = limit.parameter.as_str();
    findings.error(&format!("{path}.parameter"), format!("limit on \"{name}\": no such parameter; {help}"));
}

fn limit_holds(limit: &Limit, path: &str, findings: &mut Findings<'_>) {
    let name = limit.parameter.as_str();
    // one of its ends may be what is at fault
    let is_spoilt = findings.is_spoilt_within(path);
    let mut fault = |key: &str, why: &str| {
        let path = if key.is_empty() { path.to_owned() } else { format!("{path}.{key}") };
        findings.error(&path, format!("limit on \"{name}\": {why}"));
    };
    let ends = [
        ("upper", limit.upper),
        ("lower", limit.lower),
        ("reopen_upper", limit.reopen_upper),
        ("reopen_lower", limit.reopen_lower),
    ];
    let wrong = ends.into_iter().find(|(_, end)| end.is_some_and(|end| !end.is_finite()));
    if let Some((key, end)) = wrong {
        fault(key, &format!("{key} = {}: expected a number; it must be finite", end.unwrap_or_default()));
    } else if limit.upper.is_none() && limit.lower.is_none() && is_spoilt {
    } else if limit.upper.is_none() && limit.lower.is_none() {
        fault("", "has neither upper nor lower; give one");
    } else if let Some((upper, lower)) = limit.upper.zip(limit.lower).filter(|(upper, lower)| upper <= lower) {
        let why = format!(
            "upper = {upper} is not more than lower = {lower}, so that no value would ever be good; are they the wrong way round?"
        );
        fault("upper", &why);
    } else if limit.reopen_upper.is_some_and(|reopen| limit.upper.is_none_or(|upper| reopen > upper)) {
        fault("reopen_upper", "reopen_upper needs an upper that is not smaller");
    } else if limit.reopen_lower.is_some_and(|reopen| limit.lower.is_none_or(|lower| reopen < lower)) {
        fault("reopen_lower", "reopen_lower needs a lower that is not larger");
    } else if let Some((upper, lower)) = limit
        .reopen_upper
        .or(limit.upper)
        .zip(limit.reopen_lower.or(limit.lower))
        .filter(|(upper, lower)| upper < lower)
    {
        fault("reopen_upper", &format!("good again only up to {upper} and from {lower} on, which no value is"));
    }
    let mut fault =
        |key: &str, why: String| findings.error(&format!("{path}.{key}"), format!("limit on \"{name}\": {why}"));
    if !(0.0..=1440.0).contains(&limit.dwell_min) {
        fault("dwell_min", format!("dwell_min = {}: expected 0 to 1440 min", limit.dwell_min));
    }
    if let Some(age) = limit.max_age_s.filter(|age| !(*age > 0.0 && *age <= 86_400.0)) {
        fault("max_age_s", format!("max_age_s = {age}: expected more than 0, to 86400 s"));
    }
    if (limit.of == Measure::Value) != limit.over_min.is_none()
        || limit.over_min.is_some_and(|min| !(min > 0.0 && min <= 1440.0))
    {
        fault(
            "over_min",
            "over_min, more than 0 to 1440 min, goes with of = \"max\" or \"rate\", and only with these".into(),
        );
    }
    for (key, words) in [("vote", &limit.vote), ("disabled", &limit.disabled)] {
        if words.as_ref().is_some_and(|words| words.trim().is_empty()) {
            fault(key, format!("{key} needs words"));
        }
    }
}
