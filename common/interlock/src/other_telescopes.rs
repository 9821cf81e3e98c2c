//! The other telescopes of a site: whether one of them works under a roof.

use std::collections::BTreeMap;
use std::time::Duration;

use contract::Chunk;
use units::MachineTime;

/// Telescopes of one site.
const MOST: usize = 256;
/// Another telescope that published nothing for so long does not work.
const SILENCE: Duration = Duration::from_secs(10);

/// What the other telescopes published last.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub struct OtherTelescopes {
    works: BTreeMap<Chunk, (bool, MachineTime)>,
}

impl OtherTelescopes {
    /// A telescope has published whether it works.
    pub fn receive(&mut self, telescope: Chunk, works: bool, arrived: MachineTime) {
        if self.works.len() < MOST || self.works.contains_key(&telescope) {
            self.works.insert(telescope, (works, arrived));
        }
    }

    /// Does one of these telescopes work, as far as it published lately?
    pub fn work<'a>(&self, mut telescopes: impl Iterator<Item = &'a str>, now: MachineTime) -> bool {
        telescopes.any(|telescope| {
            let known = self.works.iter().find(|(known, _)| known.as_str() == telescope);
            known.is_some_and(|(_, (works, arrived))| *works && now.since(*arrived) <= SILENCE)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_telescope_works_until_it_publishes_that_it_does_not_or_is_silent() {
        let at = |second| MachineTime::from_boot(Duration::from_secs(second));
        let (alpha, beta): (Chunk, Chunk) = ("alpha".parse().unwrap(), "beta".parse().unwrap());
        let mut others = OtherTelescopes::default();
        let works = |others: &OtherTelescopes, second| others.work(["alpha", "gamma"].into_iter(), at(second));
        others.receive(beta, true, at(0));
        assert!(!works(&others, 0), "under another roof");
        others.receive(alpha.clone(), true, at(0));
        assert!(works(&others, 10) && !works(&others, 11));
        others.receive(alpha, false, at(12));
        assert!(!works(&others, 12));
        for number in 0..2 * MOST {
            others.receive(format!("t{number}").parse().unwrap(), true, at(12));
        }
        assert_eq!(others.works.len(), MOST);
    }
}
