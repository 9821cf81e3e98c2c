//! The telescope: ASCOM's view of the mount.

use serde_json::{Value, json};
use sky::{Horizontal, Icrs, Observer, OfDate};
use units::{Angle, Utc};

use crate::answer::{Answer, DONE, Refusal, within};
use crate::mount::{Arrival, Mount, SIDEREAL_ARCSEC_PER_S};
use crate::options::Options;
use crate::request::Request;
use crate::scene::Scene;
use crate::vendor::Vendor;

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] = &[
    "AlignmentMode",
    "Altitude",
    "ApertureArea",
    "ApertureDiameter",
    "AtHome",
    "AtPark",
    "Azimuth",
    "CanFindHome",
    "CanPark",
    "CanPulseGuide",
    "CanSetDeclinationRate",
    "CanSetGuideRates",
    "CanSetPark",
    "CanSetPierSide",
    "CanSetRightAscensionRate",
    "CanSetTracking",
    "CanSlew",
    "CanSlewAltAz",
    "CanSlewAltAzAsync",
    "CanSlewAsync",
    "CanSync",
    "CanSyncAltAz",
    "CanUnpark",
    "Declination",
    "DeclinationRate",
    "DoesRefraction",
    "EquatorialSystem",
    "FocalLength",
    "GuideRateDeclination",
    "GuideRateRightAscension",
    "IsPulseGuiding",
    "RightAscension",
    "RightAscensionRate",
    "SideOfPier",
    "SiderealTime",
    "SiteElevation",
    "SiteLatitude",
    "SiteLongitude",
    "Slewing",
    "SlewSettleTime",
    "TargetDeclination",
    "TargetRightAscension",
    "Tracking",
    "TrackingRate",
    "TrackingRates",
    "UTCDate",
];

/// The properties in `DeviceState`.
pub const STATE: &[&str] = &[
    "Altitude",
    "AtHome",
    "AtPark",
    "Azimuth",
    "Declination",
    "IsPulseGuiding",
    "RightAscension",
    "SideOfPier",
    "SiderealTime",
    "Slewing",
    "Tracking",
    "UTCDate",
];

/// Methods that answer only when the slew is over.
pub const WAITS_FOR_SLEW: &[&str] = &["slewtocoordinates", "slewtotarget", "slewtoaltaz"];

/// Guide rate, deg per second: half the sidereal rate.
const GUIDE_DEG_PER_S: f64 = 0.5 * SIDEREAL_ARCSEC_PER_S / 3600.0;

/// One second of right ascension per sidereal second, arcsec per second.
const RA_S_PER_SIDEREAL_S: f64 = 15.0 * 1.002_737_909_36;

/// A mount with a telescope on it.
#[derive(Debug)]
pub struct Telescope {
    /// The machine.
    pub mount: Mount,
    /// `AtPark` is true whatever is the case, and `Park` then does nothing.
    pub lies_about_park: bool,
    /// Its controller, where one was requested.
    pub vendor: Option<Vendor>,
    options: Options,
    /// Relative to the stars, arcsec per second, of right ascension and declination as the mount counts them.
    pub rates: [f64; 2],
    target_ra_h: Option<f64>,
    target_dec_deg: Option<f64>,
    guide_deg_per_s: [f64; 2],
    tracking_rate: i32,
    park: Horizontal,
}

impl Telescope {
    /// Parked: low, facing the equator.
    pub fn new(options: &Options, observer: &Observer) -> Self {
        let south = options.latitude.degrees() >= 0.0;
        let park = Horizontal::from_degrees(10.0, if south { 180.0 } else { 0.0 });
        Self {
            mount: Mount::parked_at(observer.to_icrs(&park), options.mount, options.seed),
            lies_about_park: false,
            vendor: None,
            options: options.clone(),
            rates: [0.0; 2],
            target_ra_h: None,
            target_dec_deg: None,
            guide_deg_per_s: [GUIDE_DEG_PER_S; 2],
            tracking_rate: 0,
            park,
        }
    }

    /// Turns the rates of the mount's own coordinates to those of its axes, which count in J2000.
    pub fn turn_rates(&mut self, observer: &Observer) {
        if !self.options.mount.of_date || self.rates == [0.0; 2] {
            self.mount.rates = self.rates;
            return;
        }
        let here = observer.to_of_date(&self.mount.encoders());
        let on = |coordinate: Angle, rate: f64| coordinate + Angle::from_arcseconds(rate);
        let there = OfDate { ra: on(here.ra, self.rates[0]), dec: on(here.dec, self.rates[1]) };
        let (here, there) = (observer.of_date_to_icrs(&here), observer.of_date_to_icrs(&there));
        self.mount.rates = [(there.ra - here.ra).wrapped_signed().arcseconds(), (there.dec - here.dec).arcseconds()];
    }

    /// Answers a GET.
    pub fn get(&self, request: &Request, scene: &Scene) -> Answer {
        let mount = &self.mount;
        let horizontal = || scene.observer.to_horizontal(&mount.encoders());
        Ok(match request.member.as_str() {
            "alignmentmode" => json!(if self.options.mount.german { 2 } else { 1 }),
            "altitude" => json!(horizontal().altitude.degrees()),
            "azimuth" => json!(horizontal().azimuth.degrees()),
            "aperturearea" => json!((self.options.camera.aperture_mm / 2e3).powi(2) * std::f64::consts::PI),
            "aperturediameter" => json!(self.options.camera.aperture_mm / 1e3),
            "focallength" => json!(self.options.camera.focal_length_mm / 1e3),
            "athome" => json!(mount.home),
            "atpark" => json!(mount.parked || self.lies_about_park),
            "canfindhome" | "canpark" | "canpulseguide" | "cansetguiderates" | "cansetpark" | "cansettracking"
            | "canslew" | "canslewaltaz" | "canslewaltazasync" | "canslewasync" | "cansync" | "canunpark" => {
                json!(true)
            }
            "cansetrightascensionrate" | "cansetdeclinationrate" => json!(self.options.mount.takes_rates),
            "cansetpierside" | "cansyncaltaz" | "doesrefraction" => json!(false),
            "canmoveaxis" => json!(axis(request)? < 2),
            "axisrates" => match axis(request)? {
                0 | 1 => json!([{ "Minimum": 0.0, "Maximum": self.options.mount.slew_deg_per_s }]),
                _ => json!([]),
            },
            "rightascension" => json!(scene.to_mount(mount.encoders()).0),
            "declination" => json!(scene.to_mount(mount.encoders()).1),
            // ASCOM counts this rate in seconds of right ascension per sidereal second.
            "rightascensionrate" => json!(self.rates[0] / RA_S_PER_SIDEREAL_S),
            "declinationrate" => json!(self.rates[1]),
            "equatorialsystem" => json!(if self.options.mount.of_date { 1 } else { 2 }),
            "guideraterightascension" => json!(self.guide_deg_per_s[0]),
            "guideratedeclination" => json!(self.guide_deg_per_s[1]),
            "ispulseguiding" => json!(mount.is_pulse_guiding()),
            "sideofpier" => json!(i32::from(mount.pier_west)),
            "destinationsideofpier" => {
                let target = scene.icrs_of_mount(request.number("RightAscension")?, request.number("Declination")?);
                json!(i32::from(mount.destination_is_west(&scene.observer, target)))
            }
            "siderealtime" => json!(scene.observer.sidereal_time().wrapped_positive().hours()),
            "siteelevation" => json!(self.options.elevation_m),
            "sitelatitude" => json!(self.options.latitude.degrees()),
            "sitelongitude" => json!(self.options.longitude.degrees()),
            "slewing" => json!(mount.is_slewing()),
            "slewsettletime" => json!(mount.settle_s.round() as i32),
            "targetrightascension" => json!(self.target_ra_h.ok_or(Refusal::value_not_set("TargetRightAscension"))?),
            "targetdeclination" => json!(self.target_dec_deg.ok_or(Refusal::value_not_set("TargetDeclination"))?),
            "tracking" => json!(mount.tracking),
            "trackingrate" => json!(self.tracking_rate),
            "trackingrates" => json!([0, 1, 2]),
            "utcdate" => json!(scene.now.strftime("%Y-%m-%dT%H:%M:%S.%3fZ")),
            _ => return Err(Refusal::UnknownMember),
        })
    }

    /// Executes a PUT.
    pub fn put(&mut self, request: &Request, scene: &Scene) -> Answer {
        match request.member.as_str() {
            "abortslew" => {
                self.refuse_parked()?;
                self.mount.abort();
            }
            "findhome" => {
                self.refuse_parked()?;
                let home = Icrs { ra: scene.observer.sidereal_time(), dec: Angle::from_degrees(0.0) };
                self.mount.slew_to(&scene.observer, home, Arrival::Home);
            }
            "park" => {
                if !self.lies_about_park && !self.mount.parked {
                    self.mount.slew_to(&scene.observer, scene.observer.to_icrs(&self.park), Arrival::Park);
                }
            }
            "setpark" => self.park = scene.observer.to_horizontal(&self.mount.encoders()),
            "unpark" if self.vendor.as_ref().is_some_and(Vendor::is_in_error) => {
                return Err(Refusal::invalid_operation("the controller has latched errors"));
            }
            "unpark" => self.mount.parked = false,
            "tracking" => {
                let tracking = request.truth("Tracking")?;
                if tracking {
                    self.refuse_parked()?;
                }
                self.mount.tracking = tracking;
            }
            "moveaxis" => self.move_axis(axis(request)?, request.number("Rate")?)?,
            "pulseguide" => self.pulse_guide(request.integer("Direction")?, request.number("Duration")?)?,
            "slewtocoordinates" | "slewtocoordinatesasync" | "synctocoordinates" => {
                let target = (right_ascension(request, "RightAscension")?, declination(request, "Declination")?);
                self.refuse_unready()?;
                (self.target_ra_h, self.target_dec_deg) = (Some(target.0), Some(target.1));
                self.go(request.member.starts_with("sync"), scene)?;
            }
            "slewtotarget" | "slewtotargetasync" | "synctotarget" => {
                self.go(request.member.starts_with("sync"), scene)?;
            }
            "slewtoaltaz" | "slewtoaltazasync" => {
                let azimuth = within("Azimuth", request.number("Azimuth")?, 0.0, 360.0)?;
                let altitude = within("Altitude", request.number("Altitude")?, -90.0, 90.0)?;
                self.refuse_parked()?;
                if self.mount.tracking {
                    return Err(Refusal::invalid_operation("slewing in azimuth is not possible while tracking"));
                }
                let target = scene.observer.to_icrs(&Horizontal::from_degrees(altitude, azimuth));
                self.mount.slew_to(&scene.observer, target, Arrival::Target);
            }
            "targetrightascension" => self.target_ra_h = Some(right_ascension(request, "TargetRightAscension")?),
            "targetdeclination" => self.target_dec_deg = Some(declination(request, "TargetDeclination")?),
            "rightascensionrate" | "declinationrate" if !self.options.mount.takes_rates => {
                return Err(Refusal::not_implemented(&request.member));
            }
            "rightascensionrate" => self.rates[0] = request.number("RightAscensionRate")? * RA_S_PER_SIDEREAL_S,
            "declinationrate" => self.rates[1] = request.number("DeclinationRate")?,
            "guideraterightascension" => self.guide_deg_per_s[0] = guide_rate(request, "GuideRateRightAscension")?,
            "guideratedeclination" => self.guide_deg_per_s[1] = guide_rate(request, "GuideRateDeclination")?,
            "slewsettletime" => {
                self.mount.settle_s = within("SlewSettleTime", request.number("SlewSettleTime")?, 0.0, 60.0)?
            }
            "trackingrate" => {
                self.tracking_rate = within("TrackingRate", request.number("TrackingRate")?, 0.0, 2.0)? as i32;
            }
            "utcdate" => {
                let text = request.text("UTCDate")?;
                text.parse::<Utc>().map_err(|error| Refusal::invalid_value(error.to_string()))?;
            }
            "doesrefraction" | "sideofpier" | "synctoaltaz" | "siteelevation" | "sitelatitude" | "sitelongitude" => {
                return Err(Refusal::not_implemented(&request.member));
            }
            _ => return Err(Refusal::UnknownMember),
        }
        DONE
    }

    fn refuse_parked(&self) -> Result<(), Refusal> {
        if self.mount.parked || self.lies_about_park { Err(Refusal::parked()) } else { Ok(()) }
    }

    fn refuse_unready(&self) -> Result<(), Refusal> {
        self.refuse_parked()?;
        if self.mount.tracking { Ok(()) } else { Err(Refusal::invalid_operation("not tracking")) }
    }

    fn go(&mut self, sync: bool, scene: &Scene) -> Result<(), Refusal> {
        self.refuse_unready()?;
        let ra_h = self.target_ra_h.ok_or(Refusal::value_not_set("TargetRightAscension"))?;
        let dec_deg = self.target_dec_deg.ok_or(Refusal::value_not_set("TargetDeclination"))?;
        let target = scene.icrs_of_mount(ra_h, dec_deg);
        if sync {
            self.mount.sync(target);
            return Ok(());
        }
        if scene.observer.to_horizontal(&target).altitude.degrees() < 0.0 {
            return Err(Refusal::invalid_value("target is below the horizon"));
        }
        self.mount.slew_to(&scene.observer, target, Arrival::Target);
        Ok(())
    }

    fn move_axis(&mut self, axis: usize, rate: f64) -> Result<(), Refusal> {
        self.refuse_parked()?;
        if axis > 1 {
            return Err(Refusal::invalid_value("no such axis"));
        }
        let fastest = self.options.mount.slew_deg_per_s;
        self.mount.axis_rates[axis] = within("Rate", rate, -fastest, fastest)?;
        self.mount.home = false;
        Ok(())
    }

    /// Directions as in ASCOM: 0 north, 1 south, 2 east, 3 west; east is towards greater right ascension, north
    /// towards greater declination on both sides of the pier, unless the mount is one that reverses it.
    fn pulse_guide(&mut self, direction: i32, duration_ms: f64) -> Result<(), Refusal> {
        self.refuse_parked()?;
        if self.mount.is_under_way() {
            return Err(Refusal::invalid_operation("not possible while slewing"));
        }
        let (axis, sign) = match direction {
            0 => (1, 1.0),
            1 => (1, -1.0),
            2 => (0, 1.0),
            3 => (0, -1.0),
            _ => return Err(Refusal::invalid_value(format!("no direction {direction}"))),
        };
        let duration_s = within("Duration", duration_ms, 0.0, 60_000.0)? / 1000.0;
        self.mount.pulse(axis, sign * self.guide_deg_per_s[axis] * 3600.0, duration_s);
        Ok(())
    }
}

fn axis(request: &Request) -> Result<usize, Refusal> {
    let axis = request.integer("Axis")?;
    usize::try_from(axis).ok().filter(|axis| *axis <= 2).ok_or(Refusal::invalid_value(format!("no axis {axis}")))
}

fn right_ascension(request: &Request, name: &str) -> Result<f64, Refusal> {
    within(name, request.number(name)?, 0.0, 24.0 - f64::EPSILON)
}

fn declination(request: &Request, name: &str) -> Result<f64, Refusal> {
    within(name, request.number(name)?, -90.0, 90.0)
}

fn guide_rate(request: &Request, name: &str) -> Result<f64, Refusal> {
    within(name, request.number(name)?, 0.0, 2.0 * SIDEREAL_ARCSEC_PER_S / 3600.0)
}

/// The true state, for tests and people.
pub fn state(telescope: &Telescope, scene: &Scene) -> Value {
    json!({
        "ra_deg": scene.pointing.icrs.ra.degrees(),
        "dec_deg": scene.pointing.icrs.dec.degrees(),
        "altitude_deg": scene.pointing.horizontal.altitude.degrees(),
        "azimuth_deg": scene.pointing.horizontal.azimuth.degrees(),
        "encoder_ra_deg": telescope.mount.encoders().ra.degrees(),
        "encoder_dec_deg": telescope.mount.encoders().dec.degrees(),
        "parked": telescope.mount.parked,
        "tracking": telescope.mount.tracking,
        "rates_arcsec_per_s": telescope.rates,
        "pier_west": telescope.mount.pier_west,
        "dec_backlash_arcsec": telescope.mount.dec_backlash_arcsec(),
    })
}
