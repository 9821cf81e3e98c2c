//! The world: one observatory under one clock, with its faults and its log, shared by all its clients.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::{Value, json};
use sky::{Icrs, SkyError};
use units::Utc;

use crate::answer::{Answer, Refusal};
use crate::clock::SkyClock;
use crate::common;
use crate::exposure::Plan;
use crate::faults::{Fault, InForce};
use crate::frame::Frame;
use crate::kind::Kind;
use crate::log::{Entry, Log};
use crate::observatory::Observatory;
use crate::options::Options;
use crate::render::render;
use crate::request::Request;
use crate::telescope;
use crate::vendor::Vendor;
use crate::weather::Quantity;

/// A simulated observatory that runs by itself.
#[derive(Debug)]
pub struct World {
    name: String,
    kinds: Vec<Kind>,
    clock: Mutex<SkyClock>,
    inner: Mutex<Inner>,
    transactions: AtomicU32,
}

#[derive(Debug)]
struct Inner {
    observatory: Observatory,
    connected: HashMap<Kind, bool>,
    faults: HashMap<Kind, InForce>,
    log: Log,
}

/// The answer of a device after its faults were applied.
#[derive(Debug)]
pub struct Reply {
    /// The answer itself.
    pub answer: Answer,
    /// The fault in force, as far as it concerns how the answer is sent.
    pub fault: Fault,
    /// Number of the PUT in the log.
    pub logged: Option<u64>,
}

impl World {
    /// The observatory of these options, whose clock starts now.
    ///
    /// # Errors
    /// When the site or the start is nowhere the sky can be computed for.
    pub fn new(options: &Options) -> Result<Self, SkyError> {
        let inner = Inner {
            observatory: Observatory::new(options)?,
            connected: HashMap::new(),
            faults: HashMap::new(),
            log: Log::default(),
        };
        Ok(Self {
            name: options.name.clone(),
            kinds: Kind::ALL.into_iter().chain(options.guide_camera.map(|_| Kind::GuideCamera)).collect(),
            clock: Mutex::new(options.clock.unwrap_or_else(|| SkyClock::at(options.start, options.speed))),
            inner: Mutex::new(inner),
            transactions: AtomicU32::new(0),
        })
    }

    /// The default observatory at another time and speed.
    ///
    /// # Errors
    /// When the start is a time the sky cannot be computed for.
    pub fn at(start: Utc, speed: f64) -> Result<Self, SkyError> {
        Self::new(&Options { start, speed, ..Options::default() })
    }

    /// The name of the server.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The world's clock, as it goes now.
    pub fn clock(&self) -> SkyClock {
        *self.clock.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts a clock that stands: a node uses it from now on.
    pub fn run_clock(&self) {
        self.clock.lock().unwrap_or_else(PoisonError::into_inner).run();
    }

    /// Stops the clock: from now on time passes only as [`Self::pass`] says, however fast this machine is. A client that
    /// asks for the clock starts it again.
    pub fn stop_clock(&self) {
        self.clock.lock().unwrap_or_else(PoisonError::into_inner).stop();
    }

    /// Lets so many sky seconds pass by a clock that stands, and draws whatever frame has been exposed by then. Needs a
    /// tokio runtime.
    pub async fn pass(self: &Arc<Self>, sky_s: f64) {
        let plans: Vec<Plan> = {
            let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
            self.clock.lock().unwrap_or_else(PoisonError::into_inner).pass(sky_s);
            inner.observatory.advance(self.now());
            inner.observatory.cameras().filter_map(|camera| camera.take_plan()).collect()
        };
        for plan in plans {
            let world = self.clone();
            // A frame that cannot be drawn is missed by who waits for it.
            let _ = tokio::task::spawn_blocking(move || world.develop(&plan)).await;
        }
    }

    /// Sky time.
    pub fn now(&self) -> Utc {
        self.clock().now()
    }

    /// Begins anew with other options, closed, parked, in fair weather and with nothing connected. The clock stands at
    /// its start until a client asks for it. Speed, address, devices and log stay.
    ///
    /// # Errors
    /// When the site or the start is nowhere the sky can be computed for; then nothing has changed.
    pub fn begin_anew(&self, change: impl FnOnce(&mut Options)) -> Result<(), SkyError> {
        let mut inner = self.lock();
        let mut options = inner.observatory.options().clone();
        change(&mut options);
        inner.observatory = Observatory::new(&options)?;
        inner.connected.clear();
        inner.faults.clear();
        let mut clock = self.clock.lock().unwrap_or_else(PoisonError::into_inner);
        *clock = SkyClock::stopped(options.start, clock.speed());
        Ok(())
    }

    /// The next server transaction number.
    pub fn next_transaction(&self) -> u32 {
        self.transactions.fetch_add(1, Ordering::Relaxed).wrapping_add(1)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        inner.observatory.advance(self.now());
        inner
    }

    /// Lets time pass; draws in the background whatever frame has been exposed. Needs a tokio runtime.
    pub fn advance(self: &Arc<Self>) {
        let plans: Vec<Plan> = self.lock().observatory.cameras().filter_map(|camera| camera.take_plan()).collect();
        for plan in plans {
            let world = self.clone();
            tokio::task::spawn_blocking(move || world.develop(&plan));
        }
    }

    fn develop(&self, plan: &Plan) {
        let frame = render(plan);
        if let Some(camera) = self.lock().observatory.cameras().find(|camera| camera.kind() == plan.device) {
            camera.develop(frame);
        }
    }

    /// Asks a device, faults included.
    pub fn ask(&self, kind: Kind, request: &Request) -> Reply {
        let now = self.now();
        let mut guard = self.lock();
        let inner = &mut *guard;
        inner.log.count(kind);
        let logged = request.is_put.then(|| inner.log.note(kind, &request.member, request.summary(), now));
        let in_force = inner.faults.get(&kind).filter(|it| it.fault.concerns(&request.member));
        let fault = in_force.map(|it| it.fault.clone()).unwrap_or_default();
        // A device that hangs, drops the line or shows an error page does not execute the request.
        let answer = if fault.hang || fault.refuse || fault.html {
            Err(Refusal::asked_for(0x500))
        } else if let Some(code) = fault.error {
            Err(Refusal::asked_for(code))
        } else {
            let connected = inner.connected.entry(kind).or_insert(false);
            common::ask(&mut inner.observatory, connected, kind, request)
        };
        let answer = match inner.faults.get_mut(&kind) {
            Some(it) if fault.stale && !request.is_put => {
                it.frozen(format!("{}?{}", request.member, request.summary()), answer)
            }
            _ => answer,
        };
        if let Some(seq) = logged.filter(|_| !(fault.hang || fault.refuse)) {
            inner.log.answered(seq, error_number(&answer));
        }
        Reply { answer, fault, logged }
    }

    /// A camera's finished frame.
    ///
    /// # Errors
    /// When there is none, or the camera is not connected.
    pub fn image(&self, kind: Kind) -> Result<Arc<Frame>, Refusal> {
        let inner = self.lock();
        if !inner.connected.get(&kind).copied().unwrap_or(false) {
            return Err(Refusal::not_connected());
        }
        let camera = inner.observatory.camera(kind).ok_or_else(Refusal::not_connected)?;
        camera.image(self.now())
    }

    /// The devices that are there: the ten, and the guide camera where one was asked for.
    pub fn kinds(&self) -> &[Kind] {
        &self.kinds
    }

    /// Sky time at which a camera's exposure under way ends.
    pub fn exposure_ends(&self, kind: Kind) -> Option<Utc> {
        self.lock().observatory.camera(kind)?.ends()
    }

    /// Whether the mount still moves.
    pub fn is_slewing(&self) -> bool {
        self.lock().observatory.telescope.mount.is_slewing()
    }

    /// Starts or ends the rain.
    pub fn rain(&self, raining: bool) {
        self.lock().observatory.weather.rain(raining);
        self.refresh();
    }

    /// The telescope slips in its mount, arcsec to the east and to the north: it reports where it was.
    pub fn slip(&self, arcsec: [f64; 2]) {
        self.lock().observatory.telescope.mount.slip(arcsec);
        self.refresh();
    }

    /// Orders a weather value in ASCOM's unit; None returns to the natural value.
    pub fn set_weather(&self, quantity: Quantity, value: Option<f64>) {
        self.lock().observatory.weather.order(quantity, value);
        self.refresh();
    }

    /// Makes the safety monitor report unsafe, or report the weather again.
    pub fn set_unsafe(&self, is_unsafe: bool) {
        self.lock().observatory.safety_monitor.ordered_unsafe = is_unsafe;
    }

    /// Cuts or restores the mains of the UPS.
    pub fn set_on_mains(&self, on_mains: bool) {
        self.lock().observatory.switch.set_on_mains(on_mains);
    }

    /// Makes the shutter stick half-way, or run freely again (at the next request to move).
    pub fn stick_shutter_half_open(&self, sticks: bool) {
        self.lock().observatory.dome.sticks_half_open = sticks;
    }

    /// Turns the dome at this speed from now on, deg per sky second: at 0 it hangs; None: as at the start.
    pub fn set_turn_speed(&self, deg_per_s: Option<f64>) {
        self.lock().observatory.dome.set_turn_speed(deg_per_s);
    }

    /// Makes the dome's turns never end, or end again.
    pub fn let_dome_run_on(&self, runs_on: bool) {
        self.lock().observatory.dome.set_runs_on(runs_on);
    }

    /// Makes the dome refuse to move its shutter while it turns, or not.
    pub fn let_shutter_need_rest(&self, needs_rest: bool) {
        self.lock().observatory.dome.shutter_needs_rest = needs_rest;
    }

    /// Makes the mount report that it is parked, and act as if it were, or report the truth again.
    pub fn lie_about_park(&self, lies: bool) {
        self.lock().observatory.telescope.lies_about_park = lies;
    }

    /// Gives the mount a controller of its maker's own; None: none.
    pub fn set_vendor(&self, vendor: Option<Vendor>) {
        self.lock().observatory.telescope.vendor = vendor;
    }

    /// Whether the mount's controller has latched errors.
    pub fn has_vendor_errors(&self) -> bool {
        self.lock().observatory.telescope.vendor.as_ref().is_some_and(Vendor::is_in_error)
    }

    /// Makes the mount stay on its side of the pier whatever it is asked, or flip again.
    pub fn ignore_flips(&self, ignores: bool) {
        self.lock().observatory.telescope.mount.ignores_flip = ignores;
    }

    /// Gives the declination gear this play, arcsec; None: as at the start.
    pub fn set_dec_backlash(&self, arcsec: Option<f64>) {
        self.lock().observatory.telescope.mount.set_dec_backlash(arcsec);
    }

    /// Makes pulses to the north go south with the tube west of the pier, or not; None: as at the start.
    pub fn reverse_dec_pulses_west(&self, reverse: Option<bool>) {
        self.lock().observatory.telescope.mount.reverse_dec_pulses_west(reverse);
    }

    /// Gives the focuser's gear this play, steps; None: as at the start.
    pub fn set_focus_backlash(&self, steps: Option<f64>) {
        self.lock().observatory.focuser.set_backlash(steps);
    }

    /// Lets the dome close itself when no PUT came for so many machine seconds; None: not at all.
    pub fn set_watchdog(&self, limit_s: Option<f64>) {
        let mut inner = self.lock();
        inner.observatory.dome.watchdog_s = limit_s;
        inner.observatory.dome.feed();
    }

    /// How often the dome's watchdog has closed it.
    pub fn watchdog_closings(&self) -> u32 {
        self.lock().observatory.dome.watchdog_closings
    }

    /// Fraction of the slit that is open, whatever the dome reports.
    pub fn dome_open(&self) -> f64 {
        self.lock().observatory.dome.open()
    }

    /// Where the telescope really looks.
    pub fn looks_at(&self) -> Icrs {
        self.lock().observatory.scene().pointing.icrs
    }

    /// Where the telescope really looks, and when that was.
    pub fn looks_at_when(&self) -> (Utc, Icrs) {
        let inner = self.lock();
        let scene = inner.observatory.scene();
        (scene.now, scene.pointing.icrs)
    }

    /// Rates of the mount relative to the stars, arcsec per second of right ascension (the coordinate) and
    /// declination.
    pub fn rates_arcsec_per_s(&self) -> [f64; 2] {
        self.lock().observatory.telescope.rates
    }

    /// Whether the mount really is parked, whatever it reports.
    pub fn is_parked(&self) -> bool {
        self.lock().observatory.telescope.mount.parked
    }

    /// Spoils a device's answers; [`Fault::default`] heals it.
    pub fn fault(&self, kind: Kind, fault: Fault) {
        let mut guard = self.lock();
        let inner = &mut *guard;
        let mut frozen = HashMap::new();
        if fault.stale {
            let connected = inner.connected.entry(kind).or_insert(false);
            let common = ["connected", "devicestate"].into_iter().map(str::to_owned);
            let own = Observatory::properties(kind).iter().map(|name| name.to_ascii_lowercase());
            for member in own.chain(common) {
                let request = Request::new(false, &member, "");
                let answer = common::ask(&mut inner.observatory, connected, kind, &request);
                frozen.insert(format!("{member}?"), answer);
            }
        }
        inner.faults.insert(kind, InForce::new(fault, frozen));
    }

    /// The faults in force.
    pub fn faults(&self) -> HashMap<Kind, Fault> {
        let inner = self.lock();
        let all = inner.faults.iter().filter(|(_, it)| it.fault != Fault::default());
        all.map(|(kind, it)| (*kind, it.fault.clone())).collect()
    }

    /// The device loses its cable: it is not connected until a client connects it again.
    pub fn lose_connection(&self, kind: Kind) {
        self.lock().connected.insert(kind, false);
    }

    /// Fair weather, true answers, no faults; devices that moved stay where they are.
    pub fn clear_faults(&self) {
        let mut inner = self.lock();
        inner.faults.clear();
        inner.observatory.weather.clear();
        inner.observatory.safety_monitor.ordered_unsafe = false;
        inner.observatory.dome.sticks_half_open = false;
        inner.observatory.dome.set_turn_speed(None);
        inner.observatory.dome.set_runs_on(false);
        inner.observatory.dome.shutter_needs_rest = false;
        inner.observatory.telescope.lies_about_park = false;
        inner.observatory.telescope.vendor = None;
        inner.observatory.telescope.mount.ignores_flip = false;
        inner.observatory.telescope.mount.set_dec_backlash(None);
        inner.observatory.telescope.mount.reverse_dec_pulses_west(None);
        inner.observatory.focuser.set_backlash(None);
        inner.observatory.switch.set_on_mains(true);
        drop(inner);
        self.refresh();
    }

    /// Every PUT with a number above `seq` (0: all), oldest first.
    pub fn puts_since(&self, seq: u64) -> Vec<Entry> {
        self.lock().log.since(seq)
    }

    /// Number and shares of all requests since the start.
    pub fn request_counts(&self) -> Value {
        let inner = self.lock();
        json!({
            "total": inner.log.total(),
            "last_minute": inner.log.last_minute(),
            "by_device": inner.log.by_device(),
        })
    }

    /// The truth about everything, as JSON.
    pub fn state(&self) -> Value {
        let inner = self.lock();
        let observatory = &inner.observatory;
        let scene = observatory.scene();
        let guide = observatory.guide_scene();
        let site = observatory.options();
        json!({
            "utc": scene.now,
            "site": {
                "latitude_deg": site.latitude.degrees(),
                "longitude_deg": site.longitude.degrees(),
                "elevation_m": site.elevation_m,
                "frame_px": site.camera.width,
            },
            "sun_altitude_deg": observatory.sun().altitude.degrees(),
            "weather": observatory.conditions.state(),
            "safe": observatory.safety_monitor.is_safe(&observatory.conditions),
            "telescope": telescope::state(&observatory.telescope, &scene),
            "camera": {
                "position_angle_deg": scene.light.position_angle.degrees(),
                "defocus_steps": scene.light.defocus_steps,
                "aperture_open": scene.light.open,
            },
            "guide_camera": guide.map(|it| json!({
                "ra_deg": it.pointing.icrs.ra.degrees(),
                "dec_deg": it.pointing.icrs.dec.degrees(),
                "position_angle_deg": it.light.position_angle.degrees(),
            })),
            "focuser": { "backlash_steps": observatory.focuser.backlash_steps() },
            "dome": observatory.dome.state(scene.light.slit_free),
            "ups": observatory.switch.state(),
        })
    }

    /// Lets changed weather take effect at once, not at the next advance of the clock.
    fn refresh(&self) {
        let mut inner = self.lock();
        inner.observatory.feel_weather();
    }
}

/// ASCOM's number of an answer; 0 for success.
pub fn error_number(answer: &Answer) -> i32 {
    match answer {
        Ok(_) => 0,
        Err(Refusal::Ascom { code, .. }) => *code,
        Err(Refusal::BadRequest(_) | Refusal::UnknownMember) => 400,
    }
}
