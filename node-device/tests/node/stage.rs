//! A device node on a private bus, and a second place on it from which a test receives and publishes.

use std::time::{Duration, Instant};

use bus::{Bus, Catch, Clock, Subscriber};
use contract::device::dome;
use contract::observatory::{Permit, Verdict};
use contract::{
    Address, Command, CommandId, Device, DeviceKind, DeviceState, Key, Kind, Payload, Reason, Refusal, Reply, Role,
};
use node::Node;
use test_support::{ALPHA, LIMIT, RunningNode, join, private_bus};
use tokio::task::JoinHandle;

pub struct Stage {
    pub bus: Bus,
    pub running: RunningNode,
    folder: tempfile::TempDir,
}

impl Stage {
    /// Starts a node with these device blocks.
    pub async fn start(devices: &str) -> Self {
        Self::start_with(devices, Clock::machine_clock()).await
    }

    /// Starts a node in a folder that was prepared.
    pub async fn start_in(devices: &str, prepare: impl FnOnce(&std::path::Path)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        prepare(folder.path());
        Self::start_at(folder, devices, Clock::machine_clock()).await
    }

    pub async fn start_with(devices: &str, clock: Clock) -> Self {
        Self::start_at(tempfile::tempdir().unwrap(), devices, clock).await
    }

    async fn start_at(folder: tempfile::TempDir, devices: &str, clock: Clock) -> Self {
        let config = config::parse(&format!("{ALPHA}{devices}"), folder.path()).unwrap();
        let bus = private_bus(clock).await;
        let node = Node::new(Role::Device, "main".parse().unwrap(), config, Default::default(), bus.clone());
        let running = RunningNode::work(node, node_device::run);
        Self { bus: join(&bus).await, running, folder }
    }

    pub fn node(&self) -> &Node {
        &self.running.node
    }

    pub fn device(&self, kind: Kind, name: &str) -> Device {
        Address::new("site", "alpha").unwrap().device(kind, &name.parse().unwrap())
    }

    pub async fn states<K: DeviceKind>(&self, name: &str) -> Subscriber<DeviceState<K::Fields>> {
        let key = Key::State(self.device(K::KIND, name));
        self.bus.subscribe(&key.to_string(), Catch::Newest, 1000).await.unwrap()
    }

    /// Waits for a state that is as wanted.
    pub async fn until<K: DeviceKind>(
        &self,
        name: &str,
        wanted: impl FnMut(&DeviceState<K::Fields>) -> bool,
    ) -> DeviceState<K::Fields> {
        until_received(name, &self.states::<K>(name).await, wanted).await
    }

    /// Sends a command; a node that is not up yet is asked again.
    pub async fn command<C: Payload>(&self, kind: Kind, name: &str, command: &Command<C>) -> Reply {
        let key = Key::Command(self.device(kind, name));
        let began = Instant::now();
        loop {
            match self.bus.ask::<_, Reply>(&key, command, Duration::from_secs(20)).await {
                Ok(reply) => return reply,
                Err(error) => assert!(began.elapsed() < LIMIT, "{error}"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Ends the node and starts another one in its folder, on a bus of its own.
    pub async fn restarted(self, devices: &str) -> Self {
        self.running.stop().await;
        Self::start_at(self.folder, devices, Clock::machine_clock()).await
    }

    pub async fn end(self) {
        self.running.stop().await;
    }
}

/// Waits for a payload that is as wanted, among all that came since they were subscribed to.
pub async fn until_received<T: Payload>(what: &str, payloads: &Subscriber<T>, mut wanted: impl FnMut(&T) -> bool) -> T {
    let mut last = None;
    let waiting = async {
        loop {
            let payload = payloads.recv().await.sample.body;
            if wanted(&payload) {
                return payload;
            }
            last = Some(serde_json::to_string(&payload).unwrap());
        }
    };
    tokio::time::timeout(LIMIT, waiting).await.unwrap_or_else(|_| panic!("{what} stayed {last:?}"))
}

pub fn command<C>(id: &str, token: Option<u64>, action: C) -> Command<C> {
    Command { id: CommandId(id.to_owned()), from: "observatory/alpha/main".to_owned(), token, boot_id: None, action }
}

pub fn accepted(reply: &Reply) -> Option<u64> {
    match reply {
        Reply::Accepted(accepted) => accepted.token,
        Reply::Refusal(refusal) => panic!("{refusal}"),
    }
}

pub fn refused(reply: &Reply) -> Reason {
    match reply {
        Reply::Accepted(accepted) => panic!("accepted {}", accepted.id),
        Reply::Refusal(Refusal { reason, .. }) => *reason,
    }
}

/// Renews a permit with every number of the guard, as a living observatory does, until it is dropped.
pub struct Commander(JoinHandle<()>);

impl Drop for Commander {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Commander {
    pub async fn start(stage: &Stage, dome: &str, token: u64) -> Self {
        Self::start_on(&stage.bus, stage, dome, token).await
    }

    /// As the process that another session of the bus belongs to.
    pub async fn start_on(bus: &Bus, stage: &Stage, dome: &str, token: u64) -> Self {
        let device = stage.device(Kind::Dome, dome);
        let key = Key::Guard(device.clone()).to_string();
        let guard = bus.subscribe::<dome::Guard>(&key, Catch::Newest, 8).await.unwrap();
        let key = Key::Permit(device.address, device.name);
        let permits = bus.publisher(&key).await.unwrap();
        Self(tokio::spawn(async move {
            loop {
                let received = guard.recv().await;
                let permit = Permit {
                    verdict: Verdict::Safe,
                    commander: "observatory/alpha/main".to_owned(),
                    token,
                    guard_number: received.sample.body.number,
                    guard_boot_id: received.sample.boot_id,
                };
                permits.put(permit).await.unwrap();
            }
        }))
    }
}
