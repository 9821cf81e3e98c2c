//! Writes the states of all devices into the database, and holds the newest ones for new headers.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::{Arc, Mutex, PoisonError};

use bus::{Catch, Received};
use config::Observatory;
use contract::device::DeviceDescription;
use contract::device::telescope::EquatorialSystem;
use contract::{Device, DeviceState, Key, NoData, Reading, Scalar, Topic};
use node::Node;
use serde_json::Value;
use units::Utc;

use crate::database::{Database, Write};
use crate::streams::{self, Lost, Stream};

/// States that wait here when the database is slow: at ten devices and 10 Hz, ten minutes.
const WAITING_STATES: usize = 65_536;

/// The newest state of every device. Cheap to clone.
#[derive(Clone, Default)]
pub struct Newest {
    devices: Arc<Mutex<HashMap<Device, DeviceTelemetry>>>,
}

#[derive(Default)]
struct DeviceTelemetry {
    readings: BTreeMap<String, Reading>,
    capabilities: Option<Value>,
}

impl Newest {
    /// The newest value of a property; some that are not read as such are among the capabilities.
    pub fn value(&self, device: &Device, property: &str) -> Option<Scalar> {
        let devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        let known = devices.get(device)?;
        let read = known.readings.get(property).and_then(Reading::value).cloned();
        read.or_else(|| {
            let description = known.capabilities.as_ref()?;
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

    /// The frame of a mount's coordinates, as the mount reports it.
    pub fn equatorial_system(&self, mount: &Device) -> EquatorialSystem {
        let devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        let known = devices.get(mount).and_then(|known| known.capabilities.as_ref());
        known
            .and_then(|description| serde_json::from_value(description["can"]["equatorial_system"].clone()).ok())
            .unwrap_or_default()
    }

    /// Has the device published anything at this instant or later?
    pub fn received_since(&self, device: &Device, at: Utc) -> bool {
        let devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        devices.get(device).is_some_and(|known| known.readings.values().any(|reading| reading.at_utc >= at))
    }

    /// Takes a state; returns the readings that are new.
    fn take(&self, device: &Device, readings: BTreeMap<String, Reading>) -> Vec<(String, Reading)> {
        let mut devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        let have = &mut devices.entry(device.clone()).or_default().readings;
        let mut new = Vec::new();
        for (property, reading) in readings {
            if have.len() >= MOST_PROPERTIES && !have.contains_key(&property) {
                continue;
            }
            let known = have.get(&property).map(|known| known.at_utc);
            if known == Some(reading.at_utc) {
                continue;
            }
            // A sample that was recovered after a cut is older than the newest one, and is stored all the same.
            if known.is_none_or(|at| at < reading.at_utc) {
                have.insert(property.clone(), reading.clone());
            }
            new.push((property, reading));
        }
        new
    }

    fn take_capabilities(&self, device: &Device, capabilities: Value) {
        let mut devices = self.devices.lock().unwrap_or_else(PoisonError::into_inner);
        devices.entry(device.clone()).or_default().capabilities = Some(capabilities);
    }
}

/// Properties of one device; ASCOM knows some sixty, and the header table may add some.
const MOST_PROPERTIES: usize = 512;

/// Stores the states of the devices of this telescope and of those that it shares with other telescopes.
pub async fn keep(node: Node, database: Database, newest: Newest) -> anyhow::Result<()> {
    let mut states = Vec::new();
    let mut capabilities = Vec::new();
    for keys in watch_keys(&node.config, Topic::State) {
        states.push(Stream::<DeviceState<Value>>::open(&node, &database, keys, WAITING_STATES).await?);
    }
    for keys in watch_keys(&node.config, Topic::Capabilities) {
        capabilities.push(node.bus.subscribe::<DeviceDescription<Value>>(&keys, Catch::Newest, 256).await?);
    }
    let mut reported = (0, 0, 0);
    let mut known = KnownDevices::of(&node.config);
    let mut looks = tokio::time::interval(streams::LOOK);
    let mut lost = Lost::new(&node, ("device states", "telemetry"));
    loop {
        tokio::select! {
            received = streams::first(&states) => {
                if matches!(&received.key, Key::State(device) if known.admits(device)) {
                    keep_state(received, &database, &newest).await?;
                }
            }
            _ = looks.tick() => lost.look(&database, &states).await?,
            received = first(&capabilities) => {
                if let Key::Capabilities(device) = &received.key
                    && known.admits(device)
                {
                    newest.take_capabilities(device, serde_json::to_value(&received.sample.body)?);
                }
            }
        }
        let given_way = states.iter().map(Stream::lost).sum::<u64>();
        let missing = states.iter().map(Stream::missing).sum::<u64>();
        let now = (database.rows(), missing, given_way);
        if now != reported {
            reported = now;
            for (figure, value) in [("rows_written", now.0), ("gaps", now.1), ("states_lost", now.2)] {
                node.figure(figure, Scalar::Int(value as i64));
            }
        }
    }
}

/// Devices whose telemetry is stored: those that the file names, and a few more, such as other shared ones of the site.
/// Any program on the bus can invent more, and each would stay in memory and in the database.
struct KnownDevices {
    named: BTreeSet<Device>,
    others: BTreeSet<Device>,
}

/// Devices that are not in the file.
const MOST_OTHERS: usize = 128;

impl KnownDevices {
    fn of(config: &Observatory) -> Self {
        let own = config.devices().into_iter().map(|(kind, common)| config.address().device(kind, &common.name));
        let shared = config.used_safety_monitors().into_iter().chain(config.used_weather());
        Self { named: own.chain(shared).chain(config.enclosures()).collect(), others: BTreeSet::new() }
    }

    fn admits(&mut self, device: &Device) -> bool {
        if self.named.contains(device) || self.others.contains(device) {
            return true;
        }
        if self.others.len() >= MOST_OTHERS {
            return false;
        }
        self.others.insert(device.clone());
        if self.others.len() == MOST_OTHERS {
            let most = MOST_OTHERS;
            tracing::warn!(most, "devices that no file names publish their states; no more of them are stored");
        }
        true
    }
}

async fn keep_state(
    received: Received<DeviceState<Value>>,
    database: &Database,
    newest: &Newest,
) -> anyhow::Result<()> {
    let written = streams::received(&received);
    let Key::State(device) = received.key else { return Ok(()) };
    for (property, reading) in newest.take(&device, received.sample.body.readings) {
        let at: Utc = reading.at_utc;
        let value = match reading.value() {
            Some(value) => Ok(value.clone()),
            None => Err(reason(&reading)),
        };
        database.put(Write::Reading { device: device.clone(), property, value, at }).await?;
    }
    Ok(database.put(written).await?)
}

fn reason(reading: &Reading) -> String {
    match &reading.outcome {
        contract::datum::ReadingOutcome::Missing { no_data: NoData(reason) } => reason.clone(),
        contract::datum::ReadingOutcome::Value { .. } => String::new(),
    }
}

/// The next payload of any of these.
pub(crate) async fn first<T: contract::Payload>(subscribers: &[bus::Subscriber<T>]) -> Received<T> {
    let waits = subscribers.iter().map(|subscriber| Box::pin(subscriber.recv()));
    futures_util::future::select_all(waits).await.0
}

/// The keys of a topic of this telescope, and of what it shares with other telescopes.
pub fn watch_keys(config: &Observatory, topic: Topic) -> Vec<String> {
    let own = config.address();
    let mut addresses = vec![own.clone(), own.shared()];
    addresses.dedup();
    addresses.iter().map(|address| topic.at(address).to_string()).collect()
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
    fn a_million_invented_devices_take_no_room_and_those_of_the_file_stay() {
        let text = "[observatory]\nsite = \"paranal\"\ntelescope = \"callisto\"\nlatitude_deg = -24.6\n\
                    longitude_deg = -70.4\nelevation_m = 2500\n[[telescope]]\nname = \"mount\"\nserver = \"127.0.0.1:1\"\n";
        let mut known = KnownDevices::of(&config::parse(text, std::path::Path::new(".")).unwrap());
        let address = Address::new("paranal", "callisto").unwrap();
        let invented = |i: u32| address.device(Kind::Switch, &format!("n{i}").parse().unwrap());
        assert_eq!((0..1_000_000).filter(|i| known.admits(&invented(*i))).count(), MOST_OTHERS);
        assert!(known.admits(&device()));
        let newest = Newest::default();
        let readings = (0..10_000).map(|i| (format!("p{i}"), reading(1, 1.0))).collect();
        assert_eq!(newest.take(&device(), readings).len(), MOST_PROPERTIES);
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
    fn capabilities_show_what_was_not_read() {
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
