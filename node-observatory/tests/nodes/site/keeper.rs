//! The fake dome's device node: its guard, its shutter, and the lease that it grants.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bus::{Bus, Clock, Latest, Service};
use contract::device::dome::{self, Dome, Guard, GuardAction, Shutter};
use contract::observatory::{Lease, Permit, Verdict};
use contract::{Address, BootId, Command, Datum, Key, Part, Reason, Refusal, Reply};

use super::{Device, accept, serve};

/// A holder that was silent for so long is dead; the real one waits 5 s.
const SILENT: Duration = Duration::from_secs(5);

/// What a test turns at the dome.
pub struct Keeper {
    pub hold: Arc<AtomicBool>,
    pub lease_held: Arc<AtomicBool>,
    pub tokens: Arc<AtomicU64>,
    pub clock: Clock,
    pub turn_deg_per_s: Arc<Mutex<Option<f64>>>,
    pub turned: Arc<Mutex<Vec<Instant>>>,
}

/// The lease: one incarnation holds it, until it is silent or has released it.
struct Arbiter {
    token: Arc<AtomicU64>,
    holder: Mutex<Option<BootId>>,
    permit: Latest<Permit>,
    lease: Latest<Lease>,
}

impl Arbiter {
    fn claim(&self, boot_id: BootId) -> Result<u64, String> {
        let mut holder = self.holder.lock().unwrap();
        let is_released = self.lease.get().is_some_and(|received| received.sample.body.holder.is_empty());
        let speaks =
            self.permit.fresh(SILENT).is_some_and(|received| Some(&received.sample.boot_id) == holder.as_ref());
        if holder.as_ref().is_some_and(|holder| *holder != boot_id) && speaks && !is_released {
            return Err("another incarnation holds the lease".to_owned());
        }
        *holder = Some(boot_id);
        Ok(self.token.fetch_add(1, Ordering::SeqCst) + 1)
    }
}

impl Keeper {
    /// Takes the dome's commands, and publishes the guard's numbers.
    pub async fn serve(self, bus: &Bus, dome: &Arc<Device<Dome>>, address: &Address) -> Service {
        let permit: Latest<Permit> = bus.latest(&Key::Permit(address.clone(), dome.key.name.clone())).await.unwrap();
        let lease = bus.latest(&Key::Observatory(address.clone(), Part::Lease)).await.unwrap();
        let guard = bus.publisher::<Guard>(&Key::Guard(dome.key.clone())).await.unwrap();
        let numbers = Arc::new(AtomicU64::new(0));
        let Self { hold, lease_held, tokens, clock, turn_deg_per_s, turned } = self;
        let (counter, token, held, shutter) = (numbers.clone(), tokens.clone(), hold.clone(), dome.clone());
        tokio::spawn(async move {
            loop {
                let number = counter.fetch_add(1, Ordering::Relaxed);
                let is_closed = shutter.state.borrow().fields.shutter == Datum::Known(Shutter::Closed);
                let body = Guard {
                    number,
                    token: token.load(Ordering::SeqCst),
                    permit_valid_s: 10.0,
                    permits: vec![],
                    may_be_open: true,
                    action: GuardAction::Watching,
                    hold: held.load(Ordering::Relaxed),
                    dropped: 0,
                    // This shutter never lies: its reports are proven.
                    verified_closed: Some(is_closed),
                    waits_for_mounts: None,
                    watchdog_s: None,
                    granted: vec![],
                };
                guard.put(body).await.unwrap();
                tokio::time::sleep(Duration::from_millis(300)).await;
            }
        });
        let arbiter = Arbiter { token: tokens.clone(), holder: Mutex::default(), permit: permit.clone(), lease };
        let at = dome.clone();
        let newest = move || tokens.load(Ordering::SeqCst);
        serve(bus, &dome.key, move |command: Command<dome::Command>| match command.action {
            dome::Command::Claim if lease_held.load(Ordering::Relaxed) => {
                refuse(&command, Reason::LeaseHeld, "observatory/other is alive")
            }
            dome::Command::Claim => match arbiter.claim(command.boot_id.clone().unwrap()) {
                Ok(token) => accept(command.id, Some(token)),
                Err(why) => refuse(&command, Reason::LeaseHeld, &why),
            },
            dome::Command::Resume => {
                hold.store(false, Ordering::Relaxed);
                at.take(command, Duration::ZERO, |_| {}, |_| {})
            }
            dome::Command::OpenShutter => {
                let number = numbers.load(Ordering::Relaxed);
                // The real guard's rule, but for the time: this one never closes, and a busy machine is none of its business.
                let valid = permit.fresh(Duration::from_secs(60)).is_some_and(|received| {
                    let permit = received.sample.body;
                    permit.verdict == Verdict::Safe && permit.token == newest() && permit.guard_number + 200 > number
                });
                if valid && command.token == Some(newest()) && !hold.load(Ordering::Relaxed) {
                    let end = |fields: &mut dome::Fields| fields.shutter = Datum::Known(Shutter::Open);
                    let start = |fields: &mut dome::Fields| fields.shutter = Datum::Known(Shutter::Opening);
                    at.take(command, Duration::from_millis(100), start, end)
                } else {
                    refuse(&command, Reason::NoPermit, "no permit")
                }
            }
            dome::Command::CloseShutter => {
                let end = |fields: &mut dome::Fields| fields.shutter = Datum::Known(Shutter::Closed);
                let start = |fields: &mut dome::Fields| fields.shutter = Datum::Known(Shutter::Closing);
                at.take(command, Duration::from_millis(100), start, end)
            }
            dome::Command::SlewToAzimuth { azimuth_deg } => {
                assert_eq!(command.token, Some(newest()), "turning needs the token");
                let from_deg = at.state.borrow().fields.azimuth_deg.known().copied().unwrap_or_default();
                let way_deg = units::Angle::from_degrees(azimuth_deg - from_deg).wrapped_signed().abs().degrees();
                let over = turn(clock.clone(), turn_deg_per_s.clone(), way_deg);
                let turned = turned.clone();
                let start = |fields: &mut dome::Fields| fields.slewing = Datum::Known(true);
                at.take_until(command, over, start, move |fields| {
                    turned.lock().unwrap().push(Instant::now());
                    (fields.azimuth_deg, fields.slewing) = (Datum::Known(azimuth_deg), Datum::Known(false));
                })
            }
            dome::Command::Slave { on } => {
                at.take(command, Duration::from_millis(20), |_| {}, move |fields| fields.slaved = Datum::Known(on))
            }
            _ => at.take(command, Duration::ZERO, |_| {}, |_| {}),
        })
        .await
    }
}

/// The dome is on its way, as fast as it turns now.
async fn turn(clock: Clock, turn_deg_per_s: Arc<Mutex<Option<f64>>>, way_deg: f64) {
    let (mut left_deg, mut before) = (way_deg, clock.sky());
    while left_deg > 0.0 {
        let speed = turn_deg_per_s.lock().unwrap().unwrap_or(0.0);
        let rest = if speed > 0.0 { Duration::from_secs_f64(left_deg / speed) } else { Duration::MAX };
        let rest = if rest == Duration::MAX { rest } else { clock.machine_duration(rest) };
        tokio::time::sleep(rest.min(Duration::from_millis(20))).await;
        let now = clock.sky();
        left_deg -= speed * now.since(before).as_secs_f64();
        before = now;
    }
}

fn refuse(command: &Command<dome::Command>, reason: Reason, detail: &str) -> Reply {
    Reply::Refusal(Refusal { id: command.id.clone(), reason, detail: detail.to_owned() })
}
