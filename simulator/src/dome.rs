//! The dome: a turning roof with a shutter, and a watchdog of its own.

use std::time::Instant;

use serde_json::{Value, json};
use units::Angle;

use crate::answer::{Answer, DONE, Refusal, within};
use crate::options::DomeOptions;
use crate::request::Request;
use crate::travel::Travel;

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] = &[
    "AtHome",
    "AtPark",
    "Azimuth",
    "CanFindHome",
    "CanPark",
    "CanSetAltitude",
    "CanSetAzimuth",
    "CanSetPark",
    "CanSetShutter",
    "CanSlave",
    "CanSyncAzimuth",
    "ShutterStatus",
    "Slaved",
    "Slewing",
];

/// The properties in `DeviceState`.
pub const STATE: &[&str] = &["AtHome", "AtPark", "Azimuth", "ShutterStatus", "Slewing"];

/// Actions beyond ASCOM's own members.
pub const ACTIONS: &[&str] = &["feedwatchdog", "watchdog"];

const HOME_DEG: f64 = 90.0;
/// A dome that runs on always has this distance before it, degrees.
const RUN_ON_DEG: f64 = 1e6;

/// A dome.
#[derive(Debug)]
pub struct Dome {
    azimuth: Travel,
    /// 0 closed, 1 open.
    shutter: Travel,
    slaved: bool,
    park_deg: f64,
    parking: bool,
    parked: bool,
    /// The shutter sticks half-way, whichever way it is sent.
    pub sticks_half_open: bool,
    runs_on: bool,
    /// The shutter's motor has no current while the dome turns: `CloseShutter` and `OpenShutter` are refused then.
    pub shutter_needs_rest: bool,
    /// Closes when no PUT came for this long, machine seconds; None: never.
    pub watchdog_s: Option<f64>,
    /// How often the watchdog has closed the dome.
    pub watchdog_closings: u32,
    received: Instant,
    turns: u32,
    turned_deg: f64,
    exposed_s: f64,
    vignetted_s: f64,
    options: DomeOptions,
}

impl Dome {
    /// Closed and parked.
    pub fn new(options: &DomeOptions) -> Self {
        Self {
            azimuth: Travel::resting(0.0, options.turn_deg_per_s),
            shutter: Travel::resting(0.0, 1.0 / options.shutter_s.max(1e-3)),
            slaved: false,
            park_deg: 0.0,
            parking: false,
            parked: true,
            sticks_half_open: false,
            runs_on: false,
            shutter_needs_rest: false,
            watchdog_s: options.watchdog_s,
            watchdog_closings: 0,
            received: Instant::now(),
            turns: 0,
            turned_deg: 0.0,
            exposed_s: 0.0,
            vignetted_s: 0.0,
            options: *options,
        }
    }

    /// The azimuth of the slit.
    pub fn azimuth(&self) -> Angle {
        Angle::from_degrees(self.azimuth.at()).wrapped_positive()
    }

    /// Turns at this speed from now on, deg per sky second; as at the start where None, not at all at 0.
    pub fn set_turn_speed(&mut self, deg_per_s: Option<f64>) {
        self.azimuth.set_speed(deg_per_s.unwrap_or(self.options.turn_deg_per_s));
    }

    /// From now on a turn never ends: the dome runs past its target, and reports that it slews, until it is stopped.
    /// With false this ends, and the dome stands.
    pub fn set_runs_on(&mut self, runs_on: bool) {
        if self.runs_on && !runs_on {
            self.azimuth.stop();
        }
        self.runs_on = runs_on;
    }

    /// Counts sky time in which the open dome let light fall on a camera that exposes, and how much of it came through
    /// an aperture that the slit did not leave free.
    pub fn count_light(&mut self, dt: f64, free: f64) {
        if self.open() > 0.0 {
            self.exposed_s += dt;
            self.vignetted_s += if free < 1.0 { dt } else { 0.0 };
        }
    }

    /// The true state; `free` of the aperture is not hidden by the slit.
    pub fn state(&self, free: f64) -> Value {
        json!({
            "open": self.open(),
            "sticks_half_open": self.sticks_half_open,
            "turning": self.azimuth.is_moving(),
            "slaved": self.slaved,
            "watchdog_s": self.watchdog_s,
            "watchdog_closings": self.watchdog_closings,
            "azimuth_deg": self.azimuth().degrees(),
            "slit_free": free,
            "turns": self.turns,
            "turned_deg": self.turned_deg,
            "exposed_s": self.exposed_s,
            "vignetted_s": self.vignetted_s,
        })
    }

    /// Fraction of the slit that is open.
    pub fn open(&self) -> f64 {
        self.shutter.at()
    }

    /// Lets sky time pass, with the telescope looking at `telescope_azimuth_deg`.
    pub fn advance(&mut self, dt: f64, telescope_azimuth_deg: f64) {
        if self.slaved {
            self.azimuth.send_round(telescope_azimuth_deg);
        }
        let before_deg = self.azimuth.at();
        if self.runs_on && self.azimuth.is_moving() {
            self.azimuth.send(before_deg + RUN_ON_DEG * (self.azimuth.target() - before_deg).signum());
        }
        self.azimuth.advance(dt);
        self.turned_deg += (self.azimuth.at() - before_deg).abs();
        if self.parking && !self.azimuth.is_moving() {
            (self.parking, self.parked) = (false, true);
        }
        self.bark();
        let before = self.shutter.at();
        self.shutter.advance(dt);
        let reaches_half = (before - 0.5) * (self.shutter.at() - 0.5) <= 0.0;
        if self.sticks_half_open && self.shutter.target() != 0.5 && reaches_half {
            self.shutter = self.shutter.moved_to(0.5);
        }
    }

    /// The hardware watchdog: an open dome that receives no commands closes itself.
    fn bark(&mut self) {
        let due = self.watchdog_s.is_some_and(|limit_s| self.received.elapsed().as_secs_f64() > limit_s);
        if due && self.shutter.target() > 0.0 {
            self.shutter.send(0.0);
            self.watchdog_closings += 1;
        }
    }

    fn shutter_status(&self) -> i32 {
        match (self.shutter.at(), self.shutter.target()) {
            (at, target) if target > at => 2,
            (at, target) if target < at => 3,
            (at, _) if at >= 1.0 => 0,
            (at, _) if at <= 0.0 => 1,
            // Neither open nor closed and at rest: error, as ASCOM has no word for ajar.
            _ => 4,
        }
    }

    /// Feeds the watchdog.
    pub fn feed(&mut self) {
        self.received = Instant::now();
    }

    /// Answers a GET.
    pub fn get(&self, request: &Request) -> Answer {
        let azimuth = self.azimuth.at().rem_euclid(360.0);
        Ok(match request.member.as_str() {
            "altitude" => return Err(Refusal::not_implemented("Altitude")),
            "athome" => json!(!self.azimuth.is_moving() && (azimuth - HOME_DEG).abs() < 0.1),
            "atpark" => json!(self.parked),
            "azimuth" => json!(azimuth),
            "cansetshutter" => json!(true),
            "canfindhome" | "canpark" | "cansetazimuth" | "cansetpark" | "canslave" | "cansyncazimuth" => {
                json!(self.options.slit.is_some())
            }
            "cansetaltitude" => json!(false),
            "shutterstatus" => json!(self.shutter_status()),
            "slaved" => json!(self.slaved),
            "slewing" => json!(self.azimuth.is_moving() || self.shutter.is_moving()),
            _ => return Err(Refusal::UnknownMember),
        })
    }

    /// Executes a PUT; any PUT feeds the watchdog.
    pub fn put(&mut self, request: &Request) -> Answer {
        self.received = Instant::now();
        match request.member.as_str() {
            "abortslew" => {
                self.slaved = false;
                self.parking = false;
                self.azimuth.stop();
                self.shutter.stop();
            }
            "closeshutter" => self.send_shutter(0.0)?,
            "openshutter" => self.send_shutter(1.0)?,
            "findhome" => self.turn(HOME_DEG)?,
            "park" => {
                if !self.parked {
                    self.slaved = false;
                    self.turn(self.park_deg)?;
                    self.parking = true;
                }
            }
            "setpark" => self.park_deg = self.azimuth.at().rem_euclid(360.0),
            "slaved" => {
                if self.options.slit.is_none() {
                    return Err(Refusal::not_implemented("Slaved"));
                }
                self.slaved = request.truth("Slaved")?;
                self.parked &= !self.slaved;
            }
            "slewtoazimuth" => self.turn(azimuth(request)?)?,
            "synctoazimuth" => {
                let here = azimuth(request)?;
                self.refuse_slaved()?;
                self.azimuth = self.azimuth.moved_to(here);
            }
            "slewtoaltitude" => return Err(Refusal::not_implemented("SlewToAltitude")),
            _ => return Err(Refusal::UnknownMember),
        }
        DONE
    }

    /// `Action`: feeds the watchdog (any PUT has done so already), or sets its limit (`off` or seconds).
    pub fn action(&mut self, action: &str, parameters: &str) -> Answer {
        self.received = Instant::now();
        match action {
            "feedwatchdog" => Ok(Value::from("fed")),
            "watchdog" => {
                self.watchdog_s = parameters.trim().parse().ok().filter(|limit_s: &f64| *limit_s > 0.0);
                Ok(Value::from(self.watchdog_s.map_or("off".to_owned(), |limit_s| format!("{limit_s} s"))))
            }
            _ => Err(Refusal::action_not_implemented(action)),
        }
    }

    fn send_shutter(&mut self, target: f64) -> Result<(), Refusal> {
        if self.shutter_needs_rest && self.azimuth.is_moving() {
            return Err(Refusal::invalid_operation("the shutter does not move while the dome turns"));
        }
        self.shutter.send(target);
        Ok(())
    }

    fn turn(&mut self, azimuth_deg: f64) -> Result<(), Refusal> {
        if self.options.slit.is_none() {
            return Err(Refusal::not_implemented("turning"));
        }
        self.refuse_slaved()?;
        self.turns += 1;
        self.azimuth.send_round(azimuth_deg);
        (self.parking, self.parked) = (false, false);
        Ok(())
    }

    fn refuse_slaved(&self) -> Result<(), Refusal> {
        if self.slaved { Err(Refusal::slaved()) } else { Ok(()) }
    }
}

fn azimuth(request: &Request) -> Result<f64, Refusal> {
    within("Azimuth", request.number("Azimuth")?, 0.0, 360.0 - 1e-9)
}
