//! The permit of each enclosure: renewed every second, so that silence closes.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bus::{Publisher, Quality};
use contract::device::dome::Guard;
use contract::observatory::{Permit, Verdict};
use contract::{BootId, Key};

use crate::control_room::ControlRoom;
use crate::rig::dome::Dome;
use crate::rig::guards::Guards;

/// A guard publishes a number each second, and the permit that answers it is as young as it can be. While no guard is
/// received, permits go out all the same.
const PERIOD: Duration = Duration::from_millis(1200);

/// Renews every permit when its guard's number arrives and at each change of the verdict, while this node commands.
pub async fn keep_renewing(room: Arc<ControlRoom>) -> anyhow::Result<()> {
    let mut lines: Vec<(&Dome, Publisher<Permit>)> = Vec::new();
    for dome in &room.rig.domes {
        let key = Key::Permit(room.node.config.address(), dome.instrument.device.name.clone());
        lines.push((dome, room.node.bus.publisher(&key, Quality::Urgent).await?));
    }
    let mut guards: Vec<_> = room.rig.domes.iter().map(|dome| dome.guards.clone()).collect();
    let (mut ruling, mut hold) = (room.ruling.clone(), room.hold.clone());
    loop {
        let told = verdict(&room);
        for (dome, line) in &lines {
            for permit in permits(&room, dome, told) {
                if let Err(error) = line.put(permit).await {
                    tracing::warn!(%error, dome = %dome.instrument.device.name, "a permit was not sent");
                }
            }
        }
        let changed = async {
            while verdict(&room) == told {
                tokio::select! {
                    _ = ruling.changed() => {}
                    _ = hold.changed() => return,
                    () = heard(&mut guards) => return,
                }
            }
        };
        let _ = tokio::time::timeout(PERIOD, changed).await;
    }
}

/// Waits for the next number of any guard.
async fn heard(guards: &mut [Guards]) {
    if guards.is_empty() {
        std::future::pending::<()>().await;
    }
    futures_util::future::select_all(guards.iter_mut().map(|guard| Box::pin(guard.changed()))).await;
}

fn verdict(room: &ControlRoom) -> Verdict {
    let leaves = room.leaves_alone.load(Ordering::Relaxed);
    if room.is_safe() && !leaves { Verdict::Safe } else { Verdict::Unsafe }
}

/// A permit needs a lease, a guard's number to answer to, and a verdict that was formed on received inputs. Every node
/// that publishes in a guard's name is answered, each with its own number, so that a stranger takes nothing from the
/// real one.
fn permits(room: &ControlRoom, dome: &Dome, verdict: Verdict) -> Vec<Permit> {
    let Some(token) = room.hold.borrow().token().filter(|_| room.ruling.borrow().settled) else { return Vec::new() };
    let mut guards = dome.guards.living(room.node.bus.clock().machine());
    if guards.is_empty() {
        guards.extend(dome.guard.get().map(|heard| (heard.said.boot_id, heard.said.body)));
    }
    let permit = |(guard_boot_id, said): (BootId, Guard)| Permit {
        verdict,
        commander: room.node.signature(),
        token,
        guard_number: said.number,
        guard_boot_id,
    };
    guards.into_iter().map(permit).collect()
}
