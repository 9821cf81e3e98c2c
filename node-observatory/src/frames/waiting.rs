//! Frames that wait to be measured: the newest first, because it shows what is true now.

use std::collections::{BTreeSet, VecDeque};

use contract::CommandId;
use contract::device::camera::Frame;

/// Frames that wait, at most; they are announcements without pixels.
pub const MOST: usize = 64;
/// Frames remembered as done; a spool repeats what nobody has taken yet.
const REMEMBERED: usize = 4096;

/// A frame that was announced.
#[derive(Debug, Clone, PartialEq)]
pub struct Announced {
    /// The announcement.
    pub frame: Frame,
    /// It was announced before this node started: another node may have measured it.
    pub is_old: bool,
}

/// The frames that wait.
#[derive(Debug, Default)]
pub struct Waiting {
    /// In order of announcement.
    frames: VecDeque<Announced>,
    done: VecDeque<CommandId>,
}

impl Waiting {
    /// Takes an announcement in. One that is repeated, perhaps with a new address, takes the place of the first. The
    /// oldest that finds no room is returned.
    pub fn push(&mut self, announced: Announced) -> Option<Announced> {
        let id = &announced.frame.id;
        if self.done.contains(id) {
            return None;
        }
        if let Some(known) = self.frames.iter_mut().find(|known| known.frame.id == *id) {
            known.frame = announced.frame;
            return None;
        }
        // Frames that are recovered from before a cut come after new ones.
        let place = self.frames.partition_point(|known| known.frame.started_utc <= announced.frame.started_utc);
        self.frames.insert(place, announced);
        (self.frames.len() > MOST).then(|| self.frames.pop_front()).flatten()
    }

    /// The newest frame of a camera that is not busy.
    pub fn next(&mut self, busy: &BTreeSet<String>) -> Option<Announced> {
        let at = self.frames.iter().rposition(|known| !busy.contains(&known.frame.camera))?;
        self.frames.remove(at)
    }

    /// Nobody needs to measure this frame any more.
    pub fn settle(&mut self, frame: &CommandId) {
        self.frames.retain(|known| known.frame.id != *frame);
        if !self.done.contains(frame) {
            self.done.push_back(frame.clone());
        }
        if self.done.len() > REMEMBERED {
            self.done.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use units::Utc;

    use super::super::tests::frame;
    use super::*;

    fn announced(id: &str, camera: &str, at_s: f64) -> Announced {
        let started_utc = Utc::from_seconds(1.8e9 + at_s);
        let frame = Frame { camera: camera.to_owned(), started_utc, ..frame(id) };
        Announced { frame, is_old: false }
    }

    fn order(waiting: &mut Waiting) -> Vec<String> {
        std::iter::from_fn(|| waiting.next(&BTreeSet::new())).map(|next| next.frame.id.0).collect()
    }

    #[test]
    fn the_newest_comes_first_also_when_the_past_arrives_late() {
        let mut waiting = Waiting::default();
        for (id, at_s) in [("c", 30.0), ("d", 40.0), ("a", 10.0), ("b", 20.0)] {
            assert_eq!(waiting.push(announced(id, "cam", at_s)), None);
        }
        assert_eq!(order(&mut waiting), ["d", "c", "b", "a"]);
    }

    #[test]
    fn a_busy_camera_keeps_no_other_waiting() {
        let mut waiting = Waiting::default();
        waiting.push(announced("a", "guider", 10.0));
        waiting.push(announced("b", "main", 20.0));
        let busy = BTreeSet::from(["main".to_owned()]);
        assert_eq!(waiting.next(&busy).unwrap().frame.id.0, "a");
        assert_eq!(waiting.next(&busy), None);
    }

    #[test]
    fn the_oldest_gives_way() {
        let mut waiting = Waiting::default();
        for n in 0..MOST {
            assert_eq!(waiting.push(announced(&format!("f{n}"), "cam", n as f64)), None);
        }
        assert_eq!(waiting.push(announced("new", "cam", 1e3)).unwrap().frame.id.0, "f0");
        assert_eq!(waiting.next(&BTreeSet::new()).unwrap().frame.id.0, "new");
    }

    #[test]
    fn a_repeat_brings_its_new_address_and_what_is_done_is_not_done_again() {
        let mut waiting = Waiting::default();
        waiting.push(announced("a", "cam", 10.0));
        let mut again = announced("a", "cam", 10.0);
        again.frame.url = "http://elsewhere/".to_owned();
        waiting.push(again.clone());
        assert_eq!(waiting.next(&BTreeSet::new()).unwrap().frame.url, "http://elsewhere/");
        waiting.settle(&again.frame.id);
        assert_eq!(waiting.push(again), None);
        assert_eq!(waiting.next(&BTreeSet::new()), None);
        waiting.push(announced("b", "cam", 20.0));
        waiting.settle(&CommandId("b".to_owned()));
        assert_eq!(waiting.next(&BTreeSet::new()), None, "measured by somebody else meanwhile");
    }
}
