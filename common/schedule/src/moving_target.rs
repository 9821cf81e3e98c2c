//! Reads a moving target from the parameters of a row.

use schemars::JsonSchema;
use serde::Deserialize;
use sky::moving::{Orbit, Satellite, Shape, When};
use sky::{Body, Observer};
use units::{Angle, Utc};

use crate::horizon_limits::HorizonLimits;
use crate::wrong::Wrong;

/// Orbital elements about the Sun, osculating, against ecliptic and equinox of J2000, as the Minor Planet Center gives them.
///
/// Of comets `q_au` and `tp_jd`; of asteroids `a_au`, `m_deg` and `epoch_jd`.
#[derive(Debug, Clone, Copy, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Elements {
    /// Eccentricity; 1 is a parabola.
    #[schemars(range(min = 0, max = 100), extend("unit" = "of the orbit"))]
    e: f64,
    /// Inclination.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    i_deg: f64,
    /// Longitude of the ascending node.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    node_deg: f64,
    /// Argument of the perihelion.
    #[schemars(range(min = -360, max = 360), extend("unit" = "deg"))]
    peri_deg: f64,
    /// Perihelion distance.
    #[schemars(range(min = 0, max = 1000), extend("unit" = "au"))]
    q_au: Option<f64>,
    /// Half the longer axis; negative for a hyperbola.
    #[schemars(range(min = -100_000, max = 100_000), extend("unit" = "au"))]
    a_au: Option<f64>,
    /// Passage of the perihelion, Julian date, TT.
    #[schemars(range(min = 0, max = 10_000_000), extend("unit" = "d"))]
    tp_jd: Option<f64>,
    /// Mean anomaly at the epoch.
    #[schemars(range(min = -1_000_000, max = 1_000_000), extend("unit" = "deg"))]
    m_deg: Option<f64>,
    /// Epoch of the mean anomaly, Julian date, TT.
    #[schemars(range(min = 0, max = 10_000_000), extend("unit" = "d"))]
    epoch_jd: Option<f64>,
}

impl Elements {
    /// The orbit that they describe, or what is wrong with them.
    fn orbit(&self) -> Result<Orbit, String> {
        let shape = match (self.q_au, self.a_au) {
            (Some(q_au), None) => Shape::Perihelion(q_au),
            (None, Some(a_au)) => Shape::SemiMajorAxis(a_au),
            _ => return Err("give q_au (perihelion distance) or a_au (semi-major axis), one of them".to_owned()),
        };
        let when = match (self.tp_jd, self.m_deg, self.epoch_jd) {
            (Some(tp_jd), None, _) => When::PerihelionAt(tp_jd),
            (None, Some(m_deg), Some(epoch)) => When::MeanAnomaly { anomaly: Angle::from_degrees(m_deg), epoch },
            _ => return Err("give tp_jd (time of the perihelion), or m_deg with epoch_jd (mean anomaly)".to_owned()),
        };
        let angles = [self.i_deg, self.node_deg, self.peri_deg].map(Angle::from_degrees);
        Orbit::new(shape, self.e, (angles[0], angles[1], angles[2]), when).map_err(|error| error.to_string())
    }
}

/// The parameters of a row that may name a moving target.
#[derive(Debug, Clone, Copy, Default)]
pub struct Asked<'a> {
    /// A name.
    pub lookup_name: Option<&'a str>,
    /// Two-line elements.
    pub tle: Option<&'a str>,
    /// Orbital elements.
    pub elements: Option<&'a Elements>,
    /// The row names a fixed place too, in the sky or over the ground.
    pub has_place: bool,
}

/// The step along a path at which it is checked whether the target is hidden, s, unless the window is long.
const STEP_S: f64 = 30.0;
const MOST_STEPS: f64 = 500.0;
/// The value of `lookup_name` that is used together with two-line elements.
const TLE: &str = "TLE";

impl<'a> Asked<'a> {
    /// A name that is to be looked up online: it names nothing that is known offline, and the row gives no other
    /// position of its target.
    pub fn name_to_look_up(&self) -> Option<&'a str> {
        let is_given = self.has_place || self.tle.is_some() || self.elements.is_some();
        let name = self.lookup_name.map(str::trim).filter(|name| !is_given && !name.eq_ignore_ascii_case(TLE))?;
        matches!(Body::named(name), Ok(None)).then_some(name)
    }

    /// The body, if the row names one that moves and is known offline; a refusal begins with the name of the parameter.
    ///
    /// # Errors
    /// When elements describe nothing, or when a moving target has a fixed place too.
    pub fn body(&self) -> Result<Option<Body>, Wrong> {
        let is_tle = self.lookup_name.is_some_and(|name| name.trim().eq_ignore_ascii_case(TLE));
        let body = match (self.tle, self.elements, self.lookup_name) {
            (Some(_), Some(_), _) => return Err(Wrong::of("elements", "give tle or elements, not both")),
            (Some(_), None, Some(name)) if !is_tle => {
                return Err(Wrong::of("lookup_name", format!("with tle it must be \"TLE\" or absent, found {name:?}")));
            }
            (Some(lines), None, _) => {
                let satellite = Satellite::from_lines(lines).map_err(|error| Wrong::of("tle", error.to_string()))?;
                Body::Satellite(Box::new(satellite))
            }
            (None, Some(_), Some(name)) => {
                return Err(Wrong::of(
                    "lookup_name",
                    format!("elements define where the target is; leave out {name:?}"),
                ));
            }
            (None, Some(elements), None) => {
                Body::Orbit(elements.orbit().map_err(|error| Wrong::of("elements", error))?)
            }
            (None, None, Some(_)) if is_tle => {
                return Err(Wrong::of("tle", "lookup_name is \"TLE\", but there is no tle"));
            }
            (None, None, Some(name)) if name.trim().is_empty() => return Err(Wrong::of("lookup_name", "it is empty")),
            (None, None, Some(name)) => {
                match Body::named(name).map_err(|error| Wrong::of("lookup_name", error.to_string()))? {
                    Some(body) => body,
                    // The name of a star; with a place in the same row it needs no look-up.
                    None => return Ok(None),
                }
            }
            (None, None, None) => return Ok(None),
        };
        if self.has_place {
            return Err(Wrong::of("ra", "a target that moves has no fixed place; leave out ra and dec, alt and az"));
        }
        Ok(Some(body))
    }
}

/// The time until which a body is above the horizon limits within a span, from its begin on; `observer` gives the sky.
///
/// # Errors
/// The result of `impossible` for the reason, where the body is hidden at the begin, or its path is not known.
pub fn up_until<E>(
    body: &Body,
    (from, to): (Utc, Utc),
    limits: &HorizonLimits,
    mut observer: impl FnMut(Utc) -> Result<Observer, E>,
    impossible: impl Fn(String) -> E,
) -> Result<Utc, E> {
    let step_s = STEP_S.max(to.seconds_since(from) / MOST_STEPS);
    let mut up = None;
    let mut at = from;
    loop {
        let observer = observer(at)?;
        let seen = body.seen(&observer).map_err(|error| impossible(error.to_string()))?;
        if let Some(why) = limits.hides(&seen.icrs, &observer) {
            return up.ok_or_else(|| impossible(why));
        }
        up = Some(at);
        if at >= to {
            return Ok(to);
        }
        at = at.plus_seconds(step_s).min(to);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINES: &str = "1 25544U 98067A   20194.88612269 -.00002218  00000-0 -31515-4 0  9992\n\
                         2 25544  51.6461 221.2784 0001413  89.1723 280.4612 15.49507896236008";

    fn elements(text: &str) -> Elements {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn names_lines_and_elements_name_bodies() {
        let mars = Asked { lookup_name: Some("Mars"), ..Asked::default() };
        assert!(matches!(mars.body(), Ok(Some(Body::Planet(_)))));
        for name in [None, Some("tle")] {
            let satellite = Asked { lookup_name: name, tle: Some(LINES), ..Asked::default() };
            assert!(matches!(satellite.body(), Ok(Some(Body::Satellite(_)))));
        }
        let comet =
            elements(r#"{"e": 1.0, "i_deg": 20, "node_deg": 10, "peri_deg": 5, "q_au": 0.9, "tp_jd": 2461400.5}"#);
        let asteroid = elements(
            r#"{"e": 0.08, "i_deg": 10.6, "node_deg": 80.3, "peri_deg": 73.6, "a_au": 2.77, "m_deg": 60, "epoch_jd": 2461400.5}"#,
        );
        for elements in [comet, asteroid] {
            let asked = Asked { elements: Some(&elements), ..Asked::default() };
            assert!(matches!(asked.body(), Ok(Some(Body::Orbit(_)))));
        }
        assert_eq!(Asked { has_place: true, ..Asked::default() }.body(), Ok(None));
    }

    #[test]
    fn only_what_is_not_known_offline_is_looked_up() {
        let name = |name| Asked { lookup_name: Some(name), ..Asked::default() };
        assert_eq!(name(" Vega ").name_to_look_up(), Some("Vega"));
        assert_eq!(name("Vega").body(), Ok(None));
        for asked in [name("Mars"), name("tle"), Asked { has_place: true, ..name("Vega") }, Asked::default()] {
            assert_eq!(asked.name_to_look_up(), None, "{asked:?}");
        }
    }

    #[test]
    fn what_names_no_moving_target_or_two_is_refused_by_the_parameters_name() {
        let half = elements(r#"{"e": 0.1, "i_deg": 1, "node_deg": 2, "peri_deg": 3, "a_au": 2.7, "m_deg": 60}"#);
        let name = |name| Asked { lookup_name: Some(name), ..Asked::default() };
        let cases = [
            (name("Sun"), "lookup_name"),
            (name(" "), "lookup_name"),
            (name("TLE"), "tle"),
            (Asked { tle: Some("nonsense"), ..Asked::default() }, "tle"),
            (Asked { tle: Some(LINES), ..name("ISS") }, "lookup_name"),
            (Asked { elements: Some(&half), ..Asked::default() }, "elements"),
            (Asked { elements: Some(&half), tle: Some(LINES), ..Asked::default() }, "elements"),
            (Asked { has_place: true, ..name("Moon") }, "ra"),
        ];
        for (asked, parameter) in cases {
            let refusal = asked.body().unwrap_err();
            assert_eq!(refusal.field.as_deref(), Some(parameter), "{refusal}");
        }
    }
}
