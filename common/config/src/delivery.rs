//! `[[delivery]]`: where nights are handed over to.

use std::collections::BTreeMap;
use std::path::PathBuf;

use contract::device::camera::Purpose;
use contract::{Chunk, Name};
use fits::profile::{Profile, ProfileName, check_given};
use serde::Deserialize;

use crate::bucket::{Bucket, ONE_SECRET, endpoint_fault, first_region};

/// `[[delivery]]`: a place to which the frames of each night are copied, and verified there.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Delivery {
    /// How it is called in commands, alerts and records.
    pub name: Name,
    /// A folder, also of a mounted share. It must exist.
    pub directory: Option<PathBuf>,
    /// The folder must be on another file system than `/` and the folder of images, so that a share that is not mounted
    /// is not filled in its absence.
    #[serde(default)]
    pub must_be_mounted: bool,
    /// A folder that rsync reaches: `user@host:/folder` over ssh, or `rsync://user@host:port/module/folder` of a daemon.
    pub rsync: Option<String>,
    /// Configuration file of ssh, for another port, a key or a known host.
    pub ssh_config: Option<PathBuf>,
    /// Bucket of an S3-compatible object store.
    pub bucket: Option<String>,
    /// Address of the object store; that of AWS where absent.
    pub endpoint: Option<String>,
    /// Region of the bucket.
    #[serde(default = "first_region")]
    pub region: String,
    /// Keys of objects begin so.
    #[serde(default)]
    pub prefix: String,
    /// Id of the access key.
    pub access_key: Option<String>,
    /// File that holds the secret: the secret access key of an object store, or the password of an rsync daemon.
    pub secret_file: Option<PathBuf>,
    /// Environment variable that holds the secret.
    pub secret_env: Option<String>,
    /// Kinds of frames that are delivered; all where empty.
    #[serde(default)]
    pub image_types: Vec<Chunk>,
    /// Types of actions whose frames are delivered; all where empty.
    #[serde(default)]
    pub actions: Vec<String>,
    /// Cameras whose frames are delivered; all where empty.
    #[serde(default)]
    pub cameras: Vec<Name>,
    /// Programmes whose frames are delivered, `""` for frames without one; all where empty.
    #[serde(default)]
    pub programmes: Vec<String>,
    /// What a delivered file looks like; `astra` is the archive's own file.
    #[serde(default)]
    pub profile: ProfileName,
    /// Keywords that the copies of a profile get, such as `SITEID`; the programme of a row of the schedule stays.
    #[serde(default)]
    pub set: BTreeMap<String, String>,
    /// Local mean time by which a night must have been delivered, `HH:MM`: before 12:00 of the night's morning, from
    /// 12:00 on of the day after its morning's noon.
    #[serde(default = "afternoon")]
    pub by: String,
    /// Nights of so many days are delivered without being asked; 0 delivers on request only.
    #[serde(default = "fortnight")]
    pub days: u32,
}

/// Kinds of frames by the names that files have.
const IMAGE_TYPES: [&str; 6] = ["light", "acquisition", "bias", "dark", "flat", "test"];

/// Most days of which nights are looked at every few seconds.
const MOST_DAYS: u32 = 1000;

fn afternoon() -> String {
    "15:00".to_owned()
}

fn fortnight() -> u32 {
    14
}

impl Delivery {
    /// Hours after local mean noon of the night's morning by which it must have been delivered; negative before noon.
    /// `None` where `by` is no time.
    pub fn by_hours_after_noon(&self) -> Option<f64> {
        let (hours, minutes) = self.by.split_once(':')?;
        let is_pair = |text: &str| text.len() == 2 && text.bytes().all(|byte| byte.is_ascii_digit());
        let (hours, minutes) = (is_pair(hours) && is_pair(minutes)).then_some((hours, minutes))?;
        let (hours, minutes): (f64, f64) = (hours.parse().ok()?, minutes.parse().ok()?);
        (hours < 24.0 && minutes < 60.0).then_some(hours + minutes / 60.0 - 12.0)
    }

    /// The bucket, where it is one.
    pub fn bucket(&self) -> Option<Bucket> {
        let Self { endpoint, region, prefix, access_key, secret_file, secret_env, .. } = self.clone();
        let bucket = self.bucket.clone()?;
        Some(Bucket { bucket, endpoint, region, prefix, access_key, secret_file, secret_env })
    }

    /// What a person should know, with the key it is about.
    pub(crate) fn warnings(&self) -> Vec<(&'static str, String)> {
        // A profile that cannot be used is a fault already.
        let Ok(profile) = Profile::load(self.profile) else { return Vec::new() };
        let given = |name: &str| self.set.get(name);
        let broken = profile.public.iter().filter_map(|rule| {
            given(&rule.name).filter(|value| rule.is_broken_by(value, None)).map(|value| ("set", rule.warning(value)))
        });
        let programmes = self.programmes.iter().filter_map(|programme| {
            let rule =
                profile.public.iter().find(|rule| rule.name == "PROPID" && rule.is_broken_by(programme, None))?;
            Some(("programmes", rule.warning(programme)))
        });
        broken.chain(programmes).collect()
    }

    /// What does not hold, with the key it is about.
    pub(crate) fn faults(&self) -> Vec<(&'static str, String)> {
        let mut found = Vec::new();
        let mut add = |key: &'static str, what: String| found.push((key, what));
        let ways = [self.directory.is_some(), self.rsync.is_some(), self.bucket.is_some()];
        if ways.iter().filter(|is_given| **is_given).count() != 1 {
            add("name", "expected exactly one of directory, rsync and bucket".to_owned());
        }
        if self.directory.is_none() && self.must_be_mounted {
            add("must_be_mounted", "must_be_mounted is for a directory".to_owned());
        }
        if let Some(place) = &self.rsync {
            let rest = place.strip_prefix("rsync://");
            let is_fine = match rest {
                Some(rest) => rest.split_once('/').is_some_and(|(host, module)| !host.is_empty() && !module.is_empty()),
                None => place.split_once(':').is_some_and(|(host, folder)| !host.is_empty() && !folder.is_empty()),
            };
            let user = rest.and_then(|rest| rest.split('/').next()).and_then(|host| host.split_once('@'));
            if user.is_some_and(|(user, _)| user.contains(':')) {
                // It is not quoted.
                add("rsync", "rsync holds a password: write it into secret_file or secret_env".to_owned());
            } else if !is_fine
                || place.contains(":~")
                || place.starts_with('-')
                || place.contains(|c: char| c.is_control())
            {
                add(
                    "rsync",
                    format!("rsync = {place:?}: expected user@host:/folder (without ~) or rsync://host/module/folder"),
                );
            }
        }
        if self.rsync.as_ref().is_none_or(|place| place.starts_with("rsync://")) && self.ssh_config.is_some() {
            add("ssh_config", "ssh_config is for rsync over ssh, user@host:/folder".to_owned());
        }
        match self.bucket() {
            Some(bucket) => bucket.faults().into_iter().for_each(|(key, what)| add(key, what)),
            None => {
                let fault = self.endpoint.as_deref().and_then(endpoint_fault);
                fault.into_iter().for_each(|(key, what)| add(key, what));
                if self.secret_file.is_some() && self.secret_env.is_some() {
                    add("secret_env", ONE_SECRET.to_owned());
                }
            }
        }
        for kind in self.image_types.iter().filter(|kind| !IMAGE_TYPES.contains(&kind.as_str())) {
            let help = crate::nearest::meant(kind.as_str(), IMAGE_TYPES);
            add("image_types", format!("image_types = \"{kind}\": no frames are of this kind; {help}"));
        }
        for programme in self.programmes.iter().filter(|text| !text.is_empty() && !Purpose::is_programme(text)) {
            add(
                "programmes",
                format!(
                    "programmes has {programme:?}, which is no programme: expected one as in the schedule, of at most {} \
                     characters without blanks, or \"\" for frames without one",
                    Purpose::LONGEST_PROGRAMME
                ),
            );
        }
        if self.profile == ProfileName::Astra && !self.set.is_empty() {
            add("set", "set is for the copies of a profile: add profile = \"eso\" or \"lco\"".to_owned());
        }
        match Profile::load(self.profile) {
            Ok(profile) => {
                let wrong = |(key, value): (&String, &String)| check_given(&profile, key, value).err();
                self.set.iter().filter_map(wrong).for_each(|error| add("set", format!("set: {error}")));
            }
            Err(error) => add("profile", error.to_string()),
        }
        if self.name.as_str() == "removal" {
            add("name", "the alert of removals has this name: give it another one".to_owned());
        }
        if self.days > MOST_DAYS {
            add("days", format!("days = {}: expected at most {MOST_DAYS}", self.days));
        }
        if self.by_hours_after_noon().is_none() {
            add("by", format!("by = {:?}: expected a time such as \"10:30\"", self.by));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn delivery(keys: &str) -> Delivery {
        toml::from_str(&format!("name = \"share\"\n{keys}")).unwrap()
    }

    #[test]
    fn a_time_before_noon_is_of_the_morning_and_one_after_it_of_the_next_afternoon() {
        assert_eq!(delivery("directory = \"/d\"\nby = \"09:30\"").by_hours_after_noon(), Some(-2.5));
        assert_eq!(delivery("directory = \"/d\"").by_hours_after_noon(), Some(3.0));
        for wrong in ["24:00", "9", "9:5", "-1:00", "10:60", "+1:00"] {
            assert_eq!(delivery(&format!("by = {wrong:?}")).by_hours_after_noon(), None, "{wrong}");
        }
    }

    #[test]
    fn keywords_are_given_only_where_a_profile_takes_them() {
        let faults = |keys: &str| {
            let found = delivery(&format!("directory = \"/d\"\n{keys}")).faults();
            found.into_iter().map(|(key, what)| format!("{key}: {what}")).collect::<Vec<_>>()
        };
        assert!(faults("profile = \"lco\"\nset = { PROPID = \"2026A-001\", SITEID = \"lsc\" }").is_empty());
        assert!(faults("set = { PROPID = \"A\" }")[0].contains("profile = \"eso\" or \"lco\""));
        for wrong in ["NAXIS1 = \"4\"", "siteid = \"lsc\"", "CHECKSUM = \"0\"", "ORIGIN = \"\\u00e9\""] {
            let found = faults(&format!("profile = \"eso\"\nset = {{ {wrong} }}"));
            assert!(found.len() == 1 && found[0].contains("expected a FITS keyword"), "{wrong}: {found:?}");
        }
        assert!(toml::from_str::<Delivery>("name = \"a\"\nprofile = \"esa\"").is_err());
        assert!(faults("programmes = [\"0123.C-4567\", \"\"]").is_empty());
        assert!(faults("programmes = [\"two words\"]")[0].contains("no programme"));
    }

    #[test]
    fn what_everybody_would_see_at_once_is_warned_of() {
        let warnings = |keys: &str| delivery(&format!("directory = \"/d\"\n{keys}")).warnings();
        let found = warnings("profile = \"lco\"\nset = { PROPID = \"calibrate\" }");
        assert!(found.len() == 1 && found[0].1.contains("public at once"), "{found:?}");
        assert_eq!(warnings("profile = \"lco\"\nprogrammes = [\"EPO-7\"]").len(), 1);
        assert!(warnings("profile = \"lco\"\nset = { PROPID = \"2026A-001\" }").is_empty());
        assert!(warnings("programmes = [\"EPO-7\"]").is_empty(), "the archive's own files have no such rule");
    }

    #[test]
    fn a_destination_has_one_place_and_no_password_is_quoted() {
        assert!(delivery("directory = \"/d\"").faults().is_empty());
        assert!(delivery("rsync = \"me@host:/d\"").faults().is_empty());
        assert!(delivery("rsync = \"rsync://host/module\"").faults().is_empty());
        let faults = delivery("rsync = \"rsync://me:hidden@host/module\"").faults();
        assert!(faults.len() == 1 && !faults[0].1.contains("hidden"), "{faults:?}");
        assert_eq!(delivery("directory = \"/d\"\ndays = 5000000").faults().len(), 1);
        assert_eq!(delivery("directory = \"/d\"\nrsync = \"h:/d\"").faults().len(), 1);
        assert_eq!(delivery("").faults().len(), 1);
        assert_eq!(delivery("rsync = \"-oProxyCommand=x:/d\"").faults().len(), 1);
        let wrong =
            delivery("bucket = \"b\"\naccess_key = \"k\"\nsecret_env = \"S\"\nendpoint = \"http://me:hidden@h\"");
        let faults = wrong.faults();
        assert!(faults.len() == 1 && !faults[0].1.contains("hidden"), "{faults:?}");
    }
}
