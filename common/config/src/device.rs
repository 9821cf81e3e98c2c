//! The device blocks of `observatory.toml`, one type per ASCOM kind.
//!
//! A macro spells out the common keys in each block, because serde cannot refuse unknown keys through `flatten`.

use std::collections::BTreeMap;

use contract::device::dome::CloseWithMount;
use contract::device::telescope::EquatorialSystem;
use contract::{Chunk, Kind, Name};
use serde::{Deserialize, Deserializer};

use crate::flats::Flats;
use crate::focusing::Approach;
use crate::guide_calibration::GuideStart;
use crate::slit::{Follow, Slit};
use crate::vendor::VendorPattern;
use crate::visibility::HorizonSource;

/// What every device block has.
#[derive(Debug, Clone, PartialEq)]
pub struct Common {
    /// Unique name; schedules and pairings refer to it.
    pub name: Name,
    /// Alpaca server, `host:port`.
    pub server: String,
    /// Device number on that server.
    pub number: u32,
    /// Poll period, s of machine time.
    pub period_s: f64,
    /// The device node that serves it; where absent [`crate::ENCLOSURE_NODE`] for a dome, else [`crate::MAIN_NODE`].
    pub node: Option<Name>,
    /// False: never send Connected = true, the site does that itself.
    pub connect: bool,
}

/// A device block of any kind.
pub trait Device {
    /// Its kind.
    const KIND: Kind;
    /// What it has in common with all others.
    fn common(&self) -> &Common;
}

/// Path, shown name and block of each device of a list.
pub(crate) fn blocks<D: Device>(list: &[D]) -> impl Iterator<Item = (String, String, &D)> {
    list.iter().enumerate().map(|(index, device)| {
        (format!("{}[{index}]", D::KIND), format!("{} \"{}\": ", D::KIND, device.common().name), device)
    })
}

/// Frame that a mount wants its coordinates in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EquatorialChoice {
    /// What the mount says (ASCOM EquatorialSystem); `other` counts as ICRS.
    #[default]
    Auto,
    /// J2000, taken as ICRS.
    J2000,
    /// True equator and equinox of date.
    Topocentric,
}

impl EquatorialChoice {
    /// The frame of a mount's coordinates, by what it reports, if that is known yet.
    pub fn of(self, reported: Option<EquatorialSystem>) -> EquatorialSystem {
        match self {
            Self::Auto => reported.unwrap_or_default(),
            Self::J2000 => EquatorialSystem::J2000,
            Self::Topocentric => EquatorialSystem::Topocentric,
        }
    }
}

/// `[[telescope]] limits`: where a mount stops tracking, whatever the schedule says.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MountLimits {
    /// Not lower, degrees above the horizon; targets below it are not pointed to.
    pub altitude_min_deg: f64,
    /// Not further west of the meridian, h; any where absent.
    pub hour_angle_max_h: Option<f64>,
    /// Not longer past a meridian, the upper or the lower one, on the pier side from before it, min; any where absent.
    pub meridian_past_min: Option<f64>,
}

impl Default for MountLimits {
    fn default() -> Self {
        Self { altitude_min_deg: 0.0, hour_angle_max_h: None, meridian_past_min: None }
    }
}

/// What of a parameter a limit is put on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// The newest value.
    #[default]
    Value,
    /// The largest value of the window.
    Max,
    /// The change per minute over the window.
    Rate,
}

/// What a violated limit leads to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Response {
    /// The verdict is unsafe: everything closes.
    #[default]
    Close,
    /// No exposures of the sky; the dome stays open.
    Suspend,
    /// It is reported, and nothing else.
    Advise,
}

/// One tier of a weather limit.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limit {
    /// ASCOM property (`Humidity`, `WindSpeed` ...), or `RelativeSkyTemp` (SkyTemperature - Temperature) or
    /// `DewPointMargin` (Temperature - DewPoint); of a switch `GetSwitchValue0` and so on.
    pub parameter: String,
    /// Bad above this, in the property's ASCOM unit (`rate`: that per minute).
    #[serde(default)]
    pub upper: Option<f64>,
    /// Bad below this, in the same unit.
    #[serde(default)]
    pub lower: Option<f64>,
    /// What was bad above `upper` is good again only at this or below; as `upper` where absent.
    #[serde(default)]
    pub reopen_upper: Option<f64>,
    /// What was bad below `lower` is good again only at this or above; as `lower` where absent.
    #[serde(default)]
    pub reopen_lower: Option<f64>,
    /// Of a switch: its smallest and its largest value, outside of which a value is the code of a fault and counts as
    /// missing; the range that its server gives where absent.
    #[serde(default, deserialize_with = "crate::pair::some_pair")]
    pub possible: Option<[f64; 2]>,
    /// What of the parameter is limited.
    #[serde(default)]
    pub of: Measure,
    /// The window of `max` and `rate`, sky minutes.
    #[serde(default)]
    pub over_min: Option<f64>,
    /// What a violation leads to.
    #[serde(default)]
    pub response: Response,
    /// Limits of the same name vote: each may be without a value while another one has a good one, and any bad one decides.
    #[serde(default)]
    pub vote: Option<String>,
    /// Why this limit is not applied for now; an active alert reports it.
    #[serde(default)]
    pub disabled: Option<String>,
    /// Safe again only after so long without a violation, sky minutes.
    #[serde(default = "default_dwell_min")]
    pub dwell_min: f64,
    /// A value older than this is missing, machine s; 15 for rain and wind, else 60, where absent.
    #[serde(default)]
    pub max_age_s: Option<f64>,
    /// A missing value is unsafe; `false` only where a site can do without this sensor.
    #[serde(default = "yes")]
    pub required: bool,
}

fn yes() -> bool {
    true
}

pub(crate) fn default_dwell_min() -> f64 {
    15.0
}

macro_rules! devices {
    ($($(#[$doc:meta])* $kind:ident every $period:literal {
        $($(#[$field_doc:meta])* $field:ident: $type:ty = $default:expr,)*
    })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone)]
        pub struct $kind {
            /// What every device has.
            pub common: Common,
            $($(#[$field_doc])* pub $field: $type,)*
        }

        impl<'de> Deserialize<'de> for $kind {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                #[derive(Deserialize)]
                #[serde(deny_unknown_fields)]
                struct Block {
                    name: Name,
                    server: String,
                    #[serde(default)]
                    number: u32,
                    period_s: Option<f64>,
                    node: Option<Name>,
                    connect: Option<bool>,
                    $($field: Option<$type>,)*
                }
                let block = Block::deserialize(deserializer)?;
                Ok(Self {
                    common: Common {
                        name: block.name,
                        server: block.server,
                        number: block.number,
                        period_s: block.period_s.unwrap_or($period),
                        node: block.node,
                        connect: block.connect.unwrap_or(true),
                    },
                    $($field: block.$field.unwrap_or($default),)*
                })
            }
        }

        impl Device for $kind {
            const KIND: Kind = Kind::$kind;
            fn common(&self) -> &Common {
                &self.common
            }
        }
    )*};
}

devices! {
    /// A mount.
    Telescope every 1.0 {
        /// Frame that the mount wants its coordinates in.
        equatorial_system: EquatorialChoice = EquatorialChoice::Auto,
        /// A slew that takes longer has failed, sky s.
        slew_timeout_s: f64 = 300.0,
        /// Wait after a slew before exposing, sky s.
        settle_s: f64 = 1.0,
        /// A slew that ends so near its target, by the mount's own coordinates, has arrived, degrees: mounts report
        /// positions after their own pointing model.
        arrival_tolerance_deg: f64 = 0.5,
        /// So many exposure times are waited for after a correction of the pointing, and before each frame of a pointing model.
        settle_factor: f64 = 0.0,
        /// Turn a German mount over between two frames when the next one would end too far past the meridian.
        meridian_flip: bool = false,
        /// How far past the meridian that is, min.
        meridian_flip_min: f64 = 5.0,
        /// Where tracking is stopped.
        limits: MountLimits = MountLimits::default(),
        /// Diameter of the widest telescope on it, m; for a dome whose `slit` has a width.
        aperture_m: Option<f64> = None,
        /// From the polar axis to the optical axis, m: of a German mount; 0 for forks.
        arm_m: f64 = 0.0,
        /// What walls and trees leave of its sky: `[[azimuth, altitude], ...]` in degrees, or a file of such pairs.
        horizon: Option<HorizonSource> = None,
        /// Commands of its maker's own that it may be sent; none where absent.
        vendor_commands: Vec<VendorPattern> = Vec::new(),
    }

    /// A camera, with the devices that belong to it.
    Camera every 5.0 {
        /// Cooler set point, degrees Celsius; absent for a camera without cooler.
        temperature_c: Option<f64> = None,
        /// Cold enough within this distance, K.
        temperature_tolerance_c: f64 = 1.0,
        /// Cooling that takes longer has failed, sky minutes.
        cooling_timeout_min: f64 = 30.0,
        /// Size of an unbinned pixel on the sky, arcsec, to 5 %; by the pixel size and the mount's focal length, as the
        /// devices report them, where absent.
        scale_arcsec_px: Option<f64> = None,
        /// Electrons of one ADU; what the driver reports where absent.
        electrons_per_adu: Option<f64> = None,
        /// Read noise, electrons rms; for headers, since drivers do not report it.
        read_noise_e: Option<f64> = None,
        /// A pixel of this value or above is saturated, ADU; what the driver reports as its largest value where absent.
        saturation_adu: Option<f64> = None,
        /// What a good flat is.
        flats: Flats = Flats::default(),
        /// What guide pulses do to its stars, until that is learned here.
        guide_calibration: Option<GuideStart> = None,
        /// Parameters of its rows that do not give them, by action.
        defaults: BTreeMap<String, BTreeMap<String, toml::Value>> = BTreeMap::new(),
        /// Paired mount; like each pairing below, the only one of its kind where absent.
        telescope: Option<Name> = None,
        /// Paired filter wheel.
        filterwheel: Option<Name> = None,
        /// Paired focuser.
        focuser: Option<Name> = None,
        /// Paired dome.
        dome: Option<Name> = None,
        /// Paired rotator.
        rotator: Option<Name> = None,
        /// Paired cover.
        covercalibrator: Option<Name> = None,
        /// Safety monitor named in this camera's headers.
        safetymonitor: Option<Name> = None,
        /// Weather station named in this camera's headers.
        observingconditions: Option<Name> = None,
        /// Switches named in this camera's headers.
        switch: Option<Name> = None,
    }

    /// A filter wheel.
    FilterWheel every 5.0 {
        /// Names of its filters by position, as the wheel reports them; for schedules that are checked while it is not
        /// received.
        filters: Vec<String> = Vec::new(),
    }

    /// A focuser.
    Focuser every 5.0 {
        /// Best focus, steps, until one is learned; the position found at start where absent.
        best_position: Option<i64> = None,
        /// No move when already this close, and a move that ends this close is done, steps: focusers miss a step or two.
        tolerance_steps: i64 = 2,
        /// Wait after a move, sky s.
        settle_s: f64 = 3.0,
        /// Play of the gears, steps: every position is overshot by so much and then approached from one side.
        backlash_steps: i64 = 0,
        /// The side that positions are approached from.
        approach: Approach = Approach::Upward,
        /// First and last position of a focus run are so far from its middle, steps; four times what the last run showed
        /// the critical zone to be, or 1/50 of the travel, where absent.
        search_steps: Option<i64> = None,
    }

    /// A dome or roof, with its guard.
    Dome every 1.0 {
        /// May the shutter close while the mount stops, or must it wait for the park?
        close_with_mount: CloseWithMount = CloseWithMount::Alongside,
        /// For `parked_within_s`: close anyway after so long; for `parked_only`: alert then. Machine s.
        parked_within_s: f64 = 120.0,
        /// Parked (its azimuth) when it is closed: before the shutter closes where no sky calls for closing and for a short time
        /// only, else as soon as the shutter is closed.
        park_at_close: bool = false,
        /// How long a permit lasts, machine s, 3 to 30.
        permit_valid_s: f64 = 10.0,
        /// A shutter that moves longer is stuck, sky s.
        travel_timeout_s: f64 = 90.0,
        /// The dome's own watchdog closes it when it was not fed for so long, machine s; without one an active alert
        /// says that nothing closes this dome when its device node's host dies.
        watchdog_s: Option<f64> = None,
        /// ASCOM `Action` that feeds it, sent four times in that time while the permit lives, and never else; absent
        /// where the site feeds it by itself.
        watchdog_action: Option<String> = None,
        /// Parameters of that action.
        watchdog_parameters: String = String::new(),
        /// Telescopes under it; for a dome of the file `shared` at least one, else this one alone.
        telescopes: Vec<Chunk> = Vec::new(),
        /// The part that turns it.
        follow: Follow = Follow::Auto,
        /// Its slit.
        slit: Slit = Slit::default(),
        /// Commands of its maker's own that it may be sent under a valid safe permit; none where absent.
        vendor_commands: Vec<VendorPattern> = Vec::new(),
        /// Those that it may be sent without a permit too, because closing may need them.
        vendor_commands_to_close: Vec<VendorPattern> = Vec::new(),
    }

    /// A safety monitor.
    SafetyMonitor every 1.0 {
        /// Safe again only after so long without any unsafe reading, sky minutes.
        dwell_min: f64 = default_dwell_min(),
        /// A reading older than this is unsafe, machine s; 5 x the period, at least 5 s, where absent.
        max_age_s: Option<f64> = None,
        /// Why this monitor is not applied for now; an active alert reports it.
        disabled: Option<String> = None,
    }

    /// A weather station, with its limits.
    ObservingConditions every 5.0 {
        /// What is too much.
        limit: Vec<Limit> = Vec::new(),
    }

    /// A mirror cover or flat panel.
    CoverCalibrator every 5.0 {}

    /// Switches and gauges, such as a UPS.
    Switch every 5.0 {
        /// What is too much or too little, by `GetSwitchValueN`, N counting from 0.
        limit: Vec<Limit> = Vec::new(),
    }

    /// A field rotator.
    Rotator every 5.0 {
        /// A turn that ends this close is done, degrees.
        tolerance_deg: f64 = 0.1,
    }
}
