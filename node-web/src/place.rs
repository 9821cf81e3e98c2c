//! Where a telescope stands.

use contract::{Key, Kind};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use sky::Place;
use units::Angle;

/// A place on Earth.
#[derive(Debug, Clone, Copy, PartialEq, JsonSchema, Serialize)]
pub struct PlaceOnEarth {
    /// Geodetic latitude, degrees, north positive.
    pub latitude_deg: f64,
    /// Longitude, degrees, east positive.
    pub longitude_deg: f64,
    /// Height above the ellipsoid, m.
    pub elevation_m: f64,
}

impl From<&Place> for PlaceOnEarth {
    fn from(place: &Place) -> Self {
        Self {
            latitude_deg: place.latitude().degrees(),
            longitude_deg: place.longitude_east().degrees(),
            elevation_m: place.elevation_m(),
        }
    }
}

/// Is this what a mount says of itself?
pub fn is_of_mount(key: &Key) -> bool {
    matches!(key, Key::Capabilities(device) if device.kind == Kind::Telescope)
}

/// Where a mount says that it stands.
pub fn by_mount(capabilities: &Value) -> Option<Place> {
    let number = |name: &str| capabilities["can"][name].as_f64();
    let [latitude, longitude] = [number("site_latitude_deg")?, number("site_longitude_deg")?].map(Angle::from_degrees);
    Place::new(latitude, longitude, number("site_elevation_m").unwrap_or(0.0)).ok()
}

#[cfg(test)]
mod tests {
    use contract::Address;
    use serde_json::json;

    use crate::model::tests::received;
    use crate::network::Network;

    #[test]
    fn a_telescope_stands_where_the_file_of_its_site_says_or_its_mount_or_another_mount_of_its_site() {
        let address = |telescope: &str| Address::new("ridge", telescope).unwrap();
        let network = || Network::new(bus::Clock::machine_clock(), Address::new("paranal", "callisto").unwrap());
        let mount = |telescope: &str, latitude_deg: f64| {
            let body = json!({ "can": { "site_latitude_deg": latitude_deg, "site_longitude_deg": -70.5 } });
            received(&format!("ridge/{telescope}/device/telescope/mount/capabilities"), "b", 0, 0, body)
        };
        let latitude_deg = |network: &Network, telescope: &str| {
            network.read().place(&address(telescope)).map(|(place, _)| place.latitude().degrees().round())
        };
        let other = network();
        assert_eq!(latitude_deg(&other, "delta"), None);
        assert!(other.accept(mount("gamma", -24.0)));
        assert_eq!((latitude_deg(&other, "delta"), latitude_deg(&other, "shared")), (Some(-24.0), Some(-24.0)));
        assert!(other.accept(mount("delta", -25.0)));
        assert_eq!((latitude_deg(&other, "delta"), latitude_deg(&other, "gamma")), (Some(-25.0), Some(-24.0)));
        assert_eq!(other.read().place(&Address::new("elsewhere", "delta").unwrap()), None);

        let file = json!({ "site": "ridge", "telescope": "delta", "latitude_deg": 28.0, "longitude_deg": -16.5, "elevation_m": 2400.0 });
        let file: config::Place = serde_json::from_value(file).unwrap();
        let own = Network::new(bus::Clock::machine_clock(), &file);
        assert!(own.accept(mount("delta", -25.0)));
        assert_eq!(latitude_deg(&own, "delta"), Some(28.0), "what a person wrote counts");
    }
}
