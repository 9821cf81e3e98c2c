//! Everything that devices say, into the database, and the newest of it at hand for new headers.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, PoisonError};

use bus::{Catch, Heard, Node};
use contract::device::Description;
use contract::device::telescope::EquatorialSystem;
use contract::{Device, DeviceState, Key, NoData, Reading, Scalar};
use serde_json::Value;
use units::Utc;

use crate::database::{Database, Write};
use crate::watch_keys;

/// States that wait here when the database is slow: at ten devices and 10 Hz, ten minutes.
const WAITING_STATES: usize = 65_536;

/// The newest word of every device. Cheap to clone.
#[derive(Clone, Default)]
pub struct Newest {
    devices: Arc<Mutex<HashMap<Device, Told>>>,
}

#[derive(Default)]
struct Told {
    readings: BTreeMap<String, Reading>,
    capabilities: Option<Value>,
}

impl Newest {
    /// The newest value of a property; some that are not read as such are among the capabilities.
    pub fn value(&self, device: &Device, property: &str) -> Option<Scalar> {
        let devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        let told = devices.get(device)?;
        let read = told.readings.get(property).and_then(Reading::value).cloned();
        read.or_else(|| {
            let description = told.capabilities.as_ref()?;
            let value = match property {
                "Name" => description.get("device_name")?,
                "DriverVersion" | "DriverInfo" => description.get("driver")?,
                "PixelSizeX" => description.get("can")?.get("pixel_width_um")?,
                "PixelSizeY" => description.get("can")?.get("pixel_height_um")?,
                _ => return None,
            };
            serde_json::from_value(value.clone()).ok()
        })
    }

    /// The frame that a mount says its coordinates are in.
    pub fn equatorial_system(&self, mount: &Device) -> EquatorialSystem {
        let devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        let told = devices.get(mount).and_then(|told| told.capabilities.as_ref());
        told.and_then(|description| serde_json::from_value(description["can"]["equatorial_system"].clone()).ok())
            .unwrap_or_default()
    }

    /// Was the device heard, with anything, at this instant or later?
    pub fn heard_since(&self, device: &Device, at: Utc) -> bool {
        let devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        devices.get(device).is_some_and(|told| told.readings.values().any(|reading| reading.at_utc >= at))
    }

    /// Takes a state; returns the readings that were not heard before.
    fn take(&self, device: &Device, readings: BTreeMap<String, Reading>) -> Vec<(String, Reading)> {
        let mut devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        let have = &mut devices.entry(device.clone()).or_default().readings;
        let mut new = Vec::new();
        for (property, reading) in readings {
            let known = have.get(&property).map(|known| known.at_utc);
            if known == Some(reading.at_utc) {
                continue;
            }
            // what was recovered after a cut is older than what is known, and no less worth keeping
            if known.is_none_or(|at| at < reading.at_utc) {
                have.insert(property.clone(), reading.clone());
            }
            new.push((property, reading));
        }
        new
    }

    fn take_capabilities(&self, device: &Device, said: Value) {
        let mut devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        devices.entry(device.clone()).or_default().capabilities = Some(said);
    }
}

/// Keeps what the devices of this telescope, and those it shares with its neighbours, say.
pub async fn keep(node: Node, database: Database, newest: Newest) -> anyhow::Result<()> {
    let mut states = Vec::new();
    let mut capabilities = Vec::new();
    for keys in watch_keys(&node.config, "device/*/*/state") {
        states.push(node.bus.subscribe::<DeviceState<Value>>(&keys, Catch::All, WAITING_STATES).await?);
    }
    for keys in watch_keys(&node.config, "device/*/*/capabilities") {
        capabilities.push(node.bus.subscribe::<Description<Value>>(&keys, Catch::Newest, 256).await?);
    }
    let mut told = (0, 0, 0);
    loop {
        tokio::select! {
            heard = first(&states) => keep_state(heard, &database, &newest).await?,
            heard = first(&capabilities) => {
                if let Key::Capabilities(device) = &heard.key {
                    newest.take_capabilities(device, serde_json::to_value(&heard.said.body)?);
                }
            }
        }
        let lost = states.iter().map(bus::Subscriber::lost).sum::<u64>();
        let missing = states.iter().map(bus::Subscriber::missing).sum::<u64>();
        let now = (database.rows(), missing, lost);
        if now != told {
            told = now;
            for (figure, value) in [("rows_written", now.0), ("gaps", now.1), ("states_lost", now.2)] {
                node.figure(figure, Scalar::Int(value as i64));
            }
        }
    }
}

async fn keep_state(heard: Heard<DeviceState<Value>>, database: &Database, newest: &Newest) -> anyhow::Result<()> {
    let said = (heard.said.boot_id, heard.said.seq);
    let Key::State(device) = heard.key else { return Ok(()) };
    for (property, reading) in newest.take(&device, heard.said.body.readings) {
        let at: Utc = reading.at_utc;
        let value = match reading.value() {
            Some(value) => Ok(value.clone()),
            None => Err(reason(&reading)),
        };
        database.put(Write::Reading { device: device.clone(), property, value, at, said: said.clone() }).await?;
    }
    Ok(())
}

fn reason(reading: &Reading) -> String {
    match &reading.outcome {
        contract::datum::ReadingOutcome::Missing { no_data: NoData(reason) } => reason.clone(),
        contract::datum::ReadingOutcome::Value { .. } => String::new(),
    }
}

/// The next payload of any of these.
pub(crate) async fn first<T: contract::Payload>(subscribers: &[bus::Subscriber<T>]) -> Heard<T> {
    let waits = subscribers.iter().map(|subscriber| Box::pin(subscriber.hear()));
    futures_util::future::select_all(waits).await.0
}

#[cfg(test)]
mod tests {
    use contract::{Address, Kind};

    use super::*;

    fn device() -> Device {
        Address::new("paranal", "callisto").unwrap().device(Kind::Telescope, &"mount".parse().unwrap())
    }

    fn reading(second: i64, value: f64) -> Reading {
        serde_json::from_value(serde_json::json!({
            "value": value, "at_utc": Utc::from_micros(second * 1_000_000),
        }))
        .unwrap()
    }

    #[test]
    fn a_reading_counts_once_and_an_old_one_never_hides_a_new_one() {
        let newest = Newest::default();
        let take =
            |second, value| newest.take(&device(), BTreeMap::from([("Altitude".to_owned(), reading(second, value))]));
        assert_eq!(take(10, 1.0).len(), 1);
        assert_eq!(take(10, 1.0).len(), 0, "a repeat");
        assert_eq!(take(12, 2.0).len(), 1);
        assert_eq!(take(11, 9.0).len(), 1, "recovered after a cut");
        assert_eq!(newest.value(&device(), "Altitude"), Some(Scalar::Float(2.0)));
        assert_eq!(newest.value(&device(), "Azimuth"), None);
    }

    #[test]
    fn capabilities_tell_what_was_not_read() {
        let newest = Newest::default();
        newest.take_capabilities(
            &device(),
            serde_json::json!({ "device_name": "Ten Micron", "can": { "equatorial_system": "topocentric" } }),
        );
        assert_eq!(newest.value(&device(), "Name"), Some(Scalar::Text("Ten Micron".to_owned())));
        assert_eq!(newest.value(&device(), "PixelSizeX"), None);
        assert_eq!(newest.equatorial_system(&device()), EquatorialSystem::Topocentric);
    }
}
