//! A bus on the loopback interface that only the test finds.

use bus::{Bus, Clock};

/// The settings of a session that listens on a free port, and connects to these endpoints.
pub fn private(connect: Vec<String>) -> config::Bus {
    config::Bus { listen: vec!["tcp/127.0.0.1:0".to_owned()], connect, multicast: false }
}

/// Opens the first session of a bus.
pub async fn private_bus(clock: Clock) -> Bus {
    Bus::open(&private(Vec::new()), clock).await.unwrap()
}

/// Opens one more session, which connects to this one and has the same clock.
pub async fn join(bus: &Bus) -> Bus {
    Bus::open(&private(bus.locators().await), bus.clock().clone()).await.unwrap()
}
