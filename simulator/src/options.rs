//! The options of a simulated observatory, with the demo's choices as defaults.

use std::net::{Ipv4Addr, SocketAddr};

use units::{Angle, Utc};

use crate::clock::{SkyClock, wall_clock};
use crate::transit::Transit;

/// A simulated observatory.
#[derive(Debug, Clone)]
pub struct Options {
    /// Where the Alpaca server listens; port 0 takes a free one.
    pub bind: SocketAddr,
    /// UDP port on which discovery is answered (32227 is Alpaca's); None: not at all.
    pub discovery_port: Option<u16>,
    /// The name of the server.
    pub name: String,
    /// Sky time at the start.
    pub start: Utc,
    /// Sky seconds per machine second; 1 is real time.
    pub speed: f64,
    /// The clock of another observatory under the same sky, which goes already; None: one of its own, by start and speed.
    pub clock: Option<SkyClock>,
    /// Chance itself: the same seed gives the same weather, hot pixels, scatter and faint stars.
    pub seed: u64,
    /// Geodetic latitude of the site, north positive.
    pub latitude: Angle,
    /// Longitude of the site, east positive.
    pub longitude: Angle,
    /// Height of the site above the ellipsoid, m.
    pub elevation_m: f64,
    /// The mount.
    pub mount: MountOptions,
    /// Telescope and camera.
    pub camera: CameraOptions,
    /// A guide scope with a camera of its own on the same mount; None: there is none.
    pub guide_camera: Option<GuideCameraOptions>,
    /// The dome.
    pub dome: DomeOptions,
    /// Focuser and focus.
    pub focus: FocusOptions,
    /// The filters, in wheel order.
    pub filters: Vec<Filter>,
    /// Stars whose light falls for some time.
    pub transits: Vec<Transit>,
}

/// The mount and its imperfections.
#[derive(Debug, Clone, Copy)]
pub struct MountOptions {
    /// Slewing speed of each axis, deg per sky second.
    pub slew_deg_per_s: f64,
    /// Rest after a slew before `Slewing` is false, sky seconds.
    pub settle_s: f64,
    /// Size of the systematic pointing error, arcmin.
    pub pointing_error_arcmin: f64,
    /// Scatter of repeated slews to one place, arcsec per axis; in full after a way of a degree or more, over a shorter
    /// one in proportion.
    pub scatter_arcsec: f64,
    /// Half the peak-to-peak periodic error in right ascension, arcsec.
    pub periodic_error_arcsec: f64,
    /// Period of the worm, s.
    pub worm_period_s: f64,
    /// Drift while tracking in right ascension (on the sky) and declination, arcsec per minute.
    pub drift_arcsec_per_min: (f64, f64),
    /// Play of the declination gear, arcsec: a reversal must cross it before the telescope moves. The encoder sits on
    /// the motor, so the play is not seen in `Declination`. In right ascension tracking keeps the gear loaded.
    pub dec_backlash_arcsec: f64,
    /// The effect of a pulse to the north with the tube west of the pier. False: greater declination on both sides, as
    /// ASCOM has it. True: the motor turns as it does with the tube east of the pier, so the telescope goes south, as
    /// with German mounts whose controllers do not look at the side.
    pub dec_pulses_reverse_west: bool,
    /// A German mount, which turns the camera by 180 deg between the sides of its pier.
    pub german: bool,
    /// From the polar axis of a German mount to its optical axis, m.
    pub arm_m: f64,
    /// Reports coordinates of date (`EquatorialSystem` 1) instead of J2000 (2).
    pub of_date: bool,
    /// Takes rates for moving targets (`CanSetRightAscensionRate`, `CanSetDeclinationRate`).
    pub takes_rates: bool,
}

/// Telescope and camera, as one light path.
#[derive(Debug, Clone, Copy)]
pub struct CameraOptions {
    /// Pixels along x.
    pub width: u32,
    /// Pixels along y.
    pub height: u32,
    /// Side of a pixel, um.
    pub pixel_um: f64,
    /// Focal length of the telescope, mm.
    pub focal_length_mm: f64,
    /// Free aperture, mm.
    pub aperture_mm: f64,
    /// FWHM that the optics alone give in focus, arcsec.
    pub optics_fwhm_arcsec: f64,
    /// Sky time between the end of an exposure and the image.
    pub readout_s: f64,
    /// Read noise, electrons.
    pub read_noise_e: f64,
    /// Electrons per ADU at gain 0.
    pub electrons_per_adu: f64,
    /// Bias level at offset 0, ADU.
    pub bias_adu: f64,
    /// Dark current at 0 C, electrons per second and pixel; it doubles every 6.5 K.
    pub dark_e_per_s: f64,
    /// The cooler reaches this far below the air at full power, K.
    pub cooler_reach_k: f64,
    /// Hot pixels per million.
    pub hot_per_million: f64,
    /// Electrons that a pixel holds.
    pub full_well_e: f64,
    /// Position angle of the camera's y axis (north through east) at rotator position 0, tube east of the pier.
    pub position_angle: Angle,
    /// An odd number of mirrors: with north up, east is right.
    pub mirrored: bool,
    /// Faint stars beyond the catalogue, from a seeded sky; None: only for fields under 0.75 deg.
    pub faint_stars: Option<bool>,
}

/// A guide scope: always in focus, behind the dome's slit but without cover, filter and rotator.
#[derive(Debug, Clone, Copy)]
pub struct GuideCameraOptions {
    /// Its telescope and camera, as one light path; the position angle is that with the tube east of the pier.
    pub camera: CameraOptions,
    /// Where it looks, seen from the main telescope with the tube east of the pier: east and north, arcmin.
    pub offset_arcmin: [f64; 2],
}

impl Default for GuideCameraOptions {
    /// A guide scope of 60 mm and 240 mm with small pixels: a field of 1.6 x 1.2 deg, turned against the main one
    /// and pointed next to it.
    fn default() -> Self {
        let camera = CameraOptions {
            width: 1280,
            height: 960,
            pixel_um: 3.75,
            focal_length_mm: 240.0,
            aperture_mm: 60.0,
            optics_fwhm_arcsec: 4.0,
            readout_s: 0.2,
            read_noise_e: 2.5,
            electrons_per_adu: 0.3,
            bias_adu: 200.0,
            dark_e_per_s: 0.5,
            full_well_e: 20_000.0,
            position_angle: Angle::from_degrees(17.0),
            ..CameraOptions::default()
        };
        Self { camera, offset_arcmin: [12.0, -7.0] }
    }
}

/// The dome.
#[derive(Debug, Clone, Copy)]
pub struct DomeOptions {
    /// Time the shutter takes from end to end, sky seconds.
    pub shutter_s: f64,
    /// Turning speed, deg per sky second.
    pub turn_deg_per_s: f64,
    /// Closes by itself when it gets no command for this long while open, machine seconds; None: no such watchdog.
    pub watchdog_s: Option<f64>,
    /// Its slit; None: a roof, which hides nothing once it is open, and does not turn.
    pub slit: Option<SlitOptions>,
}

/// The slit of a dome, and where the mount stands in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlitOptions {
    /// Of the dome's sphere, m.
    pub radius_m: f64,
    /// Of the slit, m.
    pub width_m: f64,
    /// How far it reaches behind the zenith along the ground, m.
    pub past_zenith_m: f64,
    /// Where the mount's axes meet, from the middle of the sphere: east, north, up, m.
    pub axes_m: [f64; 3],
}

/// The focuser, and where the focus is.
#[derive(Debug, Clone, Copy)]
pub struct FocusOptions {
    /// Greatest position, steps.
    pub max_step: i32,
    /// Size of a step, um.
    pub step_um: f64,
    /// Speed, steps per sky second.
    pub steps_per_s: f64,
    /// Best position at 10 C without filter, steps.
    pub best_step: f64,
    /// Shift of the best position, steps per K.
    pub steps_per_k: f64,
    /// Play of the gear, steps: after a move from greater positions, the optics stand this much farther out than
    /// reported.
    pub backlash_steps: f64,
}

/// One filter of the wheel.
#[derive(Debug, Clone, PartialEq)]
pub struct Filter {
    /// Name.
    pub name: String,
    /// Shift of the best focus, steps.
    pub focus_offset: i32,
    /// Fraction of star and sky light that passes.
    pub transmission: f64,
}

impl Filter {
    /// A filter.
    pub fn new(name: &str, focus_offset: i32, transmission: f64) -> Self {
        Self { name: name.to_owned(), focus_offset, transmission }
    }
}

impl Default for Options {
    /// A telescope of 1.5 deg field on Paranal, on the loopback interface, now, in real time.
    fn default() -> Self {
        Self {
            bind: SocketAddr::from((Ipv4Addr::LOCALHOST, 0)),
            discovery_port: None,
            name: "Starmesh simulator".to_owned(),
            start: wall_clock(),
            speed: 1.0,
            clock: None,
            seed: 1,
            latitude: Angle::from_degrees(-24.6272),
            longitude: Angle::from_degrees(-70.4042),
            elevation_m: 2635.0,
            mount: MountOptions::default(),
            camera: CameraOptions::default(),
            guide_camera: None,
            dome: DomeOptions::default(),
            focus: FocusOptions::default(),
            filters: vec![
                Filter::new("B", 40, 0.35),
                Filter::new("V", 0, 0.45),
                Filter::new("R", -20, 0.5),
                Filter::new("I", -60, 0.4),
                Filter::new("Clear", 15, 0.95),
            ],
            transits: Vec::new(),
        }
    }
}

impl Default for MountOptions {
    fn default() -> Self {
        Self {
            slew_deg_per_s: 6.0,
            settle_s: 2.0,
            pointing_error_arcmin: 2.0,
            scatter_arcsec: 4.0,
            periodic_error_arcsec: 2.0,
            worm_period_s: 480.0,
            drift_arcsec_per_min: (0.3, -0.2),
            dec_backlash_arcsec: 0.0,
            dec_pulses_reverse_west: false,
            german: true,
            arm_m: 0.0,
            of_date: false,
            takes_rates: true,
        }
    }
}

impl MountOptions {
    /// A mount without any error, for tests that need to know where the stars are.
    pub fn perfect() -> Self {
        Self {
            pointing_error_arcmin: 0.0,
            scatter_arcsec: 0.0,
            periodic_error_arcsec: 0.0,
            drift_arcsec_per_min: (0.0, 0.0),
            ..Self::default()
        }
    }
}

impl Default for CameraOptions {
    fn default() -> Self {
        Self {
            width: 2048,
            height: 2048,
            pixel_um: 13.5,
            focal_length_mm: 1055.0,
            aperture_mm: 350.0,
            optics_fwhm_arcsec: 5.5,
            readout_s: 1.0,
            read_noise_e: 8.0,
            electrons_per_adu: 1.3,
            bias_adu: 500.0,
            dark_e_per_s: 4.0,
            cooler_reach_k: 45.0,
            hot_per_million: 150.0,
            full_well_e: 90_000.0,
            position_angle: Angle::from_degrees(0.0),
            mirrored: false,
            faint_stars: None,
        }
    }
}

impl CameraOptions {
    /// Angle that a pixel covers.
    pub fn pixel_scale(&self) -> Angle {
        Angle::from_radians(self.pixel_um * 1e-3 / self.focal_length_mm)
    }
}

impl Default for DomeOptions {
    fn default() -> Self {
        Self { shutter_s: 30.0, turn_deg_per_s: 5.0, watchdog_s: None, slit: Some(SlitOptions::default()) }
    }
}

impl Default for SlitOptions {
    /// Wide enough for a telescope in the middle whose dome follows its azimuth within 7 deg.
    fn default() -> Self {
        Self { radius_m: 2.5, width_m: 1.0, past_zenith_m: 0.5, axes_m: [0.0; 3] }
    }
}

impl Default for FocusOptions {
    fn default() -> Self {
        Self {
            max_step: 50_000,
            step_um: 1.0,
            steps_per_s: 500.0,
            best_step: 25_000.0,
            steps_per_k: -15.0,
            backlash_steps: 0.0,
        }
    }
}
