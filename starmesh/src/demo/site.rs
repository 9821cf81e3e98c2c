//! The demo's observatories: where they are, their night, their schedules and their configuration.

use std::net::SocketAddr;

use anyhow::Context as _;
use serde_json::json;
use sky::{EarthOrientation, Icrs, Night, Place};
use units::{Angle, Utc};

use crate::fields::{FIELDS, NamedField};

/// A telescope of the demo.
#[derive(Debug, PartialEq)]
pub struct DemoTelescope {
    /// Its site.
    pub site: &'static str,
    /// Its name.
    pub name: &'static str,
    /// Latitude, degrees north.
    latitude_deg: f64,
    /// Longitude, degrees east.
    longitude_deg: f64,
    /// Height, m.
    elevation_m: f64,
}

/// Two sites of nearly the same longitude, so that their nights are the same hours.
static TELESCOPES: [DemoTelescope; 4] = [desert("alpha"), desert("beta"), ridge("gamma"), ridge("delta")];
/// More are not offered: a small machine has to simulate them, and one page shows them whole.
pub const MOST_TELESCOPES: usize = TELESCOPES.len();

const fn desert(name: &'static str) -> DemoTelescope {
    DemoTelescope { site: "demo", name, latitude_deg: -24.6272, longitude_deg: -70.4042, elevation_m: 2635.0 }
}

const fn ridge(name: &'static str) -> DemoTelescope {
    DemoTelescope { site: "ridge", name, latitude_deg: -30.17, longitude_deg: -70.8, elevation_m: 2200.0 }
}

/// What one telescope does in the night.
#[derive(Debug)]
pub struct Plan {
    /// Which telescope.
    pub telescope: &'static DemoTelescope,
    /// Its night.
    pub night: DemoNight,
    /// What it observes.
    slots: Vec<Slot>,
    /// The next telescopes of its site have their weather from the same devices as this one.
    pub shares: bool,
}

impl Plan {
    /// The plans of so many telescopes for the next night after `now`; those of one site observe different fields.
    pub fn of(count: usize, now: Utc) -> anyhow::Result<Vec<Self>> {
        let telescopes = TELESCOPES.get(..count).context("the demo has no such number of telescopes")?;
        let mut plans = Vec::new();
        for site in ["demo", "ridge"] {
            let here: Vec<&'static DemoTelescope> =
                telescopes.iter().filter(|telescope| telescope.site == site).collect();
            let Some(first) = here.first() else { continue };
            let night = DemoNight::next(first, now)?;
            let slots = night.slots(here.len())?;
            let shares = count > 1;
            let plan = |(telescope, slots)| Self { telescope, night, slots, shares };
            plans.extend(here.into_iter().zip(slots).map(plan));
        }
        Ok(plans)
    }

    /// The first of its site serves what the site shares.
    pub fn is_first_of_site(&self) -> bool {
        TELESCOPES.iter().find(|telescope| telescope.site == self.telescope.site) == Some(self.telescope)
    }

    /// Its simulated observatory.
    pub fn world(&self, start: Utc, speed: f64, size_px: u32) -> simulator::Options {
        let at = self.telescope;
        let mut world =
            simulator::Options { start, speed, name: format!("Simulator of {}", at.name), ..Default::default() };
        world.latitude = Angle::from_degrees(at.latitude_deg);
        world.longitude = Angle::from_degrees(at.longitude_deg);
        world.elevation_m = at.elevation_m;
        world.dome.watchdog_s = Some(120.0);
        // Rows ask for 0.3 arcmin: this mount repeats its slews to less than that, as most do.
        world.mount.scatter_arcsec = 1.0;
        // The same field of 1.5 deg whatever the camera's size, and stars as wide in pixels.
        let coarser = f64::from(world.camera.width) / f64::from(size_px);
        world.camera.pixel_um *= coarser;
        world.camera.optics_fwhm_arcsec *= coarser;
        (world.camera.width, world.camera.height) = (size_px, size_px);
        world
    }
}

/// The place and the time of the demo.
#[derive(Debug, Clone, Copy)]
pub struct DemoNight {
    /// Start of the simulation: a quarter of an hour before sunset.
    pub start: Utc,
    /// Nautical dusk, when the dome may open.
    pub dusk: Utc,
    /// Nautical dawn, when it must close.
    pub dawn: Utc,
    place: Place,
}

const SLOTS: u32 = 5;
/// Seconds are enough for people.
const TIME: &str = "%Y-%m-%dT%H:%M:%SZ";
const FILTERS: [&str; 5] = ["V", "R", "B", "I", "Clear"];

impl DemoNight {
    /// The next night of a telescope's place after `now`.
    fn next(at: &DemoTelescope, now: Utc) -> anyhow::Result<Self> {
        let (latitude, longitude) = (Angle::from_degrees(at.latitude_deg), Angle::from_degrees(at.longitude_deg));
        let place = Place::new(latitude, longitude, at.elevation_m)?;
        let orientation = EarthOrientation::default();
        // The night that `now` belongs to may be half over: take the one that begins at the next noon.
        let tomorrow = sky::night(&place, &orientation, now)?.ends;
        let night: Night = sky::night(&place, &orientation, tomorrow.plus_seconds(60.0))?;
        let known = |time: Option<Utc>| time.context("the Sun does not set and rise there");
        Ok(Self {
            start: known(night.sunset)?.plus_seconds(-900.0),
            dusk: known(night.nautical_dusk)?,
            dawn: known(night.nautical_dawn)?,
            place,
        })
    }

    /// The instant at this part of the time between dusk and dawn.
    pub fn at(&self, part: f64) -> Utc {
        self.dusk.plus_seconds(part * self.dawn.seconds_since(self.dusk))
    }

    /// Cuts the night into slots and gives each telescope of a site one of the fields that stay highest in it.
    fn slots(&self, telescopes: usize) -> anyhow::Result<Vec<Vec<Slot>>> {
        let length_s = (self.dawn.seconds_since(self.dusk) - 600.0) / f64::from(SLOTS);
        let mut left = FIELDS.to_vec();
        let mut slots = vec![Vec::new(); telescopes];
        for slot in 0..SLOTS {
            let start = self.dusk.plus_seconds(300.0 + f64::from(slot) * length_s);
            let end = start.plus_seconds(length_s);
            for of_telescope in &mut slots {
                let mut best: Option<(usize, f64)> = None;
                for (index, field) in left.iter().enumerate() {
                    let [ra_deg, dec_deg] = field.place(start);
                    let field = Icrs::from_degrees(ra_deg, dec_deg);
                    let lowest = sky::lowest_altitude(&self.place, &EarthOrientation::default(), &field, start, end)?;
                    let altitude_deg = lowest.altitude.degrees();
                    if best.is_none_or(|(_, highest)| altitude_deg > highest) {
                        best = Some((index, altitude_deg));
                    }
                }
                let (index, _) = best.context("no field is left for the demo")?;
                of_telescope.push(Slot { field: left.swap_remove(index), start, end });
            }
        }
        Ok(slots)
    }
}

/// A field, and when it is observed.
#[derive(Debug, Clone, Copy)]
struct Slot {
    field: NamedField,
    start: Utc,
    end: Utc,
}

impl Plan {
    /// The schedule, JSONL: cool, open, five objects pointed and guided, close, flats, darks, headers.
    pub fn schedule(&self) -> String {
        let night = &self.night;
        let mut rows = vec!["// the demo's night; the format is described in docs/operator/schedule.md".to_owned()];
        let mut row = |action: &str, value: serde_json::Value, start: Utc, end: Utc| {
            let line = json!({
                "device_name": "camera", "action_type": action, "action_value": value,
                "start_time": start.strftime(TIME), "end_time": end.strftime(TIME), "programme": "DEMO.2026",
            });
            rows.push(line.to_string());
        };
        row("cool_camera", json!({}), night.start.plus_seconds(60.0), night.dusk);
        row("open", json!({}), night.dusk, night.dawn);
        // Coarse pixels are full of sky without a filter.
        let filters = if self.shares { FILTERS.get(..4).unwrap_or(&FILTERS) } else { &FILTERS };
        for (Slot { field, start, end }, filter) in self.slots.iter().zip(filters.iter().cycle()) {
            let NamedField { name, exptime_s, .. } = field;
            let [ra_deg, dec_deg] = field.place(*start);
            let value = json!({
                "object": name, "ra": ra_deg, "dec": dec_deg, "exptime": exptime_s, "n": 20, "filter": filter,
                "pointing": true, "guiding": true,
            });
            row("object", value, *start, *end);
        }
        row("close", json!({}), night.dawn, night.dawn.plus_seconds(3600.0));
        // Behind the closed cover, which has a lamp.
        let flats = json!({ "filter": FILTERS, "n": FILTERS.map(|_| 3), "source": "panel" });
        row("flats", flats, night.dawn.plus_seconds(1.0), night.dawn.plus_seconds(2.0 * 3600.0));
        // Darks as long as the frames of the night.
        let mut exptimes: Vec<f64> = self.slots.iter().map(|slot| slot.field.exptime_s).chain([0.0]).collect();
        exptimes.sort_by(f64::total_cmp);
        exptimes.dedup();
        let counts: Vec<u32> = exptimes.iter().map(|exptime_s| if *exptime_s > 0.0 { 3 } else { 5 }).collect();
        let calibration = json!({ "exptime": exptimes, "n": counts });
        row("calibration", calibration, night.dawn.plus_seconds(2.0), night.dawn.plus_seconds(2.0 * 3600.0));
        row("complete_headers", json!({}), night.dawn.plus_seconds(3.0), night.dawn.plus_seconds(12.0 * 3600.0));
        rows.join("\n") + "\n"
    }

    /// The configuration of its nodes; one of all telescopes serves the page.
    pub fn configuration(&self, simulator: SocketAddr, web_port: Option<u16>) -> String {
        let mut text = self.head(self.telescope.name, simulator);
        text.push_str("\n[schedule]\nrobotic = true\n");
        // On a busy machine hours of this fast sky pass between two looks, and the mount drifts meanwhile.
        text.push_str("\n[pointing]\nthreshold_arcmin = 0.3\n");
        // Under this sky a rest of the usual length is an hour of the night.
        text.push_str("\n[faults]\nretries = 1\npause_s = 1\nrest_s = 2\n");
        if let Some(port) = web_port {
            text.push_str(&format!("\n[web]\nlisten = \"127.0.0.1:{port}\"\n"));
        }
        if self.shares {
            text.push_str(&format!(
                "\n[shared]\nsafetymonitor = [\"monitor\"]\nobservingconditions = [\"weather\"]\ndwell_min = 15.0\n{LIMITS}"
            ));
        } else {
            block(&mut text, simulator, "safetymonitor", "monitor", "dwell_min = 15.0\n");
            block(&mut text, simulator, "observingconditions", "weather", LIMITS);
        }
        for (kind, name, extra) in [
            ("telescope", "mount", ""),
            ("camera", "camera", "temperature_c = -20.0\nread_noise_e = 8.0\n"),
            ("filterwheel", "wheel", ""),
            ("focuser", "focuser", ""),
            ("dome", "dome", "watchdog_s = 120.0\nwatchdog_action = \"feedwatchdog\"\n"),
            ("covercalibrator", "cover", ""),
            ("switch", "power", ""),
            ("rotator", "rotator", ""),
        ] {
            block(&mut text, simulator, kind, name, extra);
        }
        text
    }

    /// The configuration of what the telescopes of its site share.
    pub fn shared_configuration(&self, simulator: SocketAddr) -> String {
        let mut text = self.head(contract::Address::SHARED, simulator);
        block(&mut text, simulator, "safetymonitor", "monitor", "");
        block(&mut text, simulator, "observingconditions", "weather", "");
        text
    }

    fn head(&self, name: &str, simulator: SocketAddr) -> String {
        let DemoTelescope { site, latitude_deg, longitude_deg, elevation_m, .. } = self.telescope;
        format!(
            r#"# written by `starmesh demo`
[observatory]
site = "{site}"
telescope = "{name}"
latitude_deg = {latitude_deg}
longitude_deg = {longitude_deg}
elevation_m = {elevation_m}

[bus]
multicast = false

[clock]
simulator = "http://{simulator}"
"#
        )
    }
}

const LIMITS: &str = "limit = [\n    { parameter = \"Humidity\", upper = 90.0, dwell_min = 15.0 },\n    \
                      { parameter = \"WindSpeed\", upper = 15.0, dwell_min = 15.0 },\n    \
                      { parameter = \"RainRate\", upper = 0.0, dwell_min = 20.0 },\n]\n";

fn block(text: &mut String, simulator: SocketAddr, kind: &str, name: &str, extra: &str) {
    text.push_str(&format!("\n[[{kind}]]\nname = \"{name}\"\nserver = \"{simulator}\"\nnumber = 0\n{extra}"));
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::fields::tests::{is_star, is_star_of_catalogue};

    fn parse(text: &str) -> config::Observatory {
        config::parse(text, std::path::Path::new(".")).unwrap()
    }

    #[test]
    fn the_configurations_and_schedules_of_all_telescopes_are_valid() {
        let address = "127.0.0.1:11111".parse().unwrap();
        let now = "2026-11-21T03:00:00Z".parse().unwrap();
        for count in 1..=MOST_TELESCOPES {
            let plans = Plan::of(count, now).unwrap();
            assert_eq!(plans.len(), count);
            for plan in &plans {
                let config = parse(&plan.configuration(address, Some(8080)));
                let night = plan.night;
                assert_eq!(config.devices().len(), if count == 1 { 10 } else { 8 });
                assert!(
                    night.start < night.dusk
                        && night.dusk < night.dawn
                        && night.dawn < night.start.plus_seconds(86_400.0)
                );
                let cameras = [config.camera[0].common.name.clone()];
                assert_eq!(schedule::parse(&plan.schedule(), &cameras).unwrap().len(), 11);
                if plan.shares && plan.is_first_of_site() {
                    let shared = parse(&plan.shared_configuration(address));
                    let names = |shared: &config::Observatory| shared.devices().len();
                    assert_eq!((shared.place.telescope.as_str(), names(&shared)), ("shared", 2));
                }
            }
            let sites: BTreeSet<&str> = plans.iter().map(|plan| plan.telescope.site).collect();
            assert_eq!(plans.iter().filter(|plan| plan.is_first_of_site()).count(), sites.len());
        }
        assert!(Plan::of(MOST_TELESCOPES + 1, now).is_err());
    }

    #[test]
    fn every_slot_has_a_field_of_its_own_well_above_the_horizon() {
        for month in 1..=12 {
            let now = format!("2026-{month:02}-15T12:00:00Z").parse().unwrap();
            for (count, lowest_deg) in [(1, 25.0), (MOST_TELESCOPES, 15.0)] {
                let plans = Plan::of(count, now).unwrap();
                for (index, plan) in plans.iter().enumerate() {
                    assert_eq!(plan.slots.len(), SLOTS as usize);
                    for Slot { field, start, end } in &plan.slots {
                        let (NamedField { name, .. }, [ra_deg, dec_deg]) = (field, field.place(*start));
                        let field = Icrs::from_degrees(ra_deg, dec_deg);
                        let (place, orientation) = (&plan.night.place, EarthOrientation::default());
                        let lowest = sky::lowest_altitude(place, &orientation, &field, *start, *end).unwrap();
                        let altitude_deg = lowest.altitude.degrees();
                        assert!(altitude_deg > lowest_deg, "{name} of {index} in month {month}: {altitude_deg}");
                        let same_site = plans.iter().filter(|other| other.telescope.site == plan.telescope.site);
                        let all = same_site.flat_map(|other| &other.slots);
                        assert_eq!(all.filter(|slot| slot.field.name == *name).count(), 1, "{name}");
                    }
                }
            }
        }
    }

    /// What a header says of a target is of the row.
    #[test]
    fn the_stars_of_each_schedule_are_where_the_catalogue_has_them_in_that_night() {
        let mut seen = BTreeSet::new();
        for now in ["2026-02-15T12:00:00Z", "2026-08-15T12:00:00Z", "2026-11-27T12:00:00Z", "2036-11-27T12:00:00Z"] {
            for plan in Plan::of(MOST_TELESCOPES, now.parse().unwrap()).unwrap() {
                for line in plan.schedule().lines().filter(|line| line.contains(r#""action_type":"object""#)) {
                    let row: serde_json::Value = serde_json::from_str(line).unwrap();
                    let value = &row["action_value"];
                    let name = value["object"].as_str().unwrap().to_owned();
                    if is_star(&name) {
                        let place = ["ra", "dec"].map(|key| value[key].as_f64().unwrap());
                        let start = row["start_time"].as_str().unwrap().parse().unwrap();
                        assert!(is_star_of_catalogue(place, start), "{name}: {place:?} in {now}");
                        seen.insert(name);
                    }
                }
            }
        }
        assert!(seen.is_superset(&BTreeSet::from(["WASP-18", "WASP-79", "WASP-121"].map(str::to_owned))), "{seen:?}");
    }
}
