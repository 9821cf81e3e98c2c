//! `[hooks]`: the site's own script, which replaces or wraps opening and closing.

use std::path::PathBuf;

use serde::Deserialize;

/// The script and how long its functions may take.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Hooks {
    /// Rhai script; none where absent.
    pub script: Option<PathBuf>,
    /// A function that takes longer is ended and has failed, sky s; while a default runs in it, that counts too.
    pub time_limit_s: f64,
    /// After opening `is_ready` must be true within this time, sky s; it is asked each second.
    pub ready_limit_s: f64,
    /// The default closing waits at most so long for `before_close` and `close`, machine s; the guards never wait.
    pub close_wait_s: f64,
}

impl Default for Hooks {
    /// 120 s until ready are the predecessor's.
    fn default() -> Self {
        Self { script: None, time_limit_s: 600.0, ready_limit_s: 120.0, close_wait_s: 5.0 }
    }
}

impl Hooks {
    /// What does not hold, in words.
    pub(crate) fn faults(&self) -> Vec<String> {
        let limits = [
            ("time_limit_s", self.time_limit_s, 1.0, 3600.0),
            ("ready_limit_s", self.ready_limit_s, 1.0, 3600.0),
            // a guard gives a commander that is silent 10 s
            ("close_wait_s", self.close_wait_s, 0.0, 10.0),
        ];
        let wrong = limits.into_iter().filter(|(_, value, low, high)| !(low..=high).contains(&value));
        wrong.map(|(key, value, low, high)| format!("hooks.{key} = {value}: expected {low} to {high} s")).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn read(block: &str) -> Result<Hooks, String> {
        let text = format!(
            "[observatory]\nsite = \"p\"\ntelescope = \"t\"\nlatitude_deg = 1\nlongitude_deg = 2\nelevation_m = 3\n{block}"
        );
        let read = crate::parse(&text, Path::new("/site"));
        read.map(|observatory| observatory.hooks).map_err(|error| error.to_string())
    }

    #[test]
    fn the_script_lies_next_to_the_configuration() {
        assert_eq!(read("").unwrap(), Hooks::default());
        let hooks = read("[hooks]\nscript = \"hooks.rhai\"\nclose_wait_s = 2\n").unwrap();
        assert_eq!((hooks.script.as_deref(), hooks.close_wait_s), (Some(Path::new("/site/hooks.rhai")), 2.0));
    }

    #[test]
    fn what_would_hold_up_closing_is_refused() {
        for (block, word) in [
            ("close_wait_s = 11", "hooks.close_wait_s = 11: expected 0 to 10 s"),
            ("close_wait_s = nan", "hooks.close_wait_s = NaN"),
            ("time_limit_s = 0", "hooks.time_limit_s = 0: expected 1 to 3600 s"),
            ("scirpt = \"x\"", "did you mean \"script\"?"),
        ] {
            let error = read(&format!("[hooks]\n{block}\n")).unwrap_err();
            assert!(error.contains(word), "{word}: {error}");
        }
    }
}
