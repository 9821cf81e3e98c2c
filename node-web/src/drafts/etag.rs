//! Strong entity tags, and what a request demands of them (RFC 9110, section 13).

use axum::http::{HeaderMap, HeaderName, header};

use crate::problem::{Code, Problem};

/// As a header has it.
pub fn quoted(tag: &str) -> String {
    format!("\"{tag}\"")
}

/// What a request demands of the state that it changes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Demand {
    /// That there is none yet: `If-None-Match: *`.
    IsNew,
    /// That there is one, whichever: `If-Match: *`.
    Exists,
    /// That it is one of these: `If-Match: "..."`. A weak tag is none of them.
    Is(Vec<String>),
}

impl Demand {
    /// What the headers of a request demand.
    ///
    /// # Errors
    /// 428 where they demand nothing.
    pub fn of(headers: &HeaderMap, what: &str) -> Result<Self, Problem> {
        let text = |name: HeaderName| {
            let values = headers.get_all(name).iter().filter_map(|value| value.to_str().ok());
            Some(values.collect::<Vec<_>>().join(",")).filter(|text| !text.trim().is_empty())
        };
        match (text(header::IF_MATCH), text(header::IF_NONE_MATCH)) {
            (Some(tags), None) if tags.trim() == "*" => Ok(Self::Exists),
            (Some(tags), None) => Ok(Self::Is(strong(&tags))),
            (None, Some(tags)) if tags.trim() == "*" => Ok(Self::IsNew),
            _ => {
                let detail = format!("Expected {what}, so that nobody's change is overwritten unseen.");
                Err(Problem::new(Code::PreconditionRequired, "Name what you change", detail))
            }
        }
    }

    /// Is it so? `now` is the tag of what is there.
    ///
    /// # Errors
    /// 412 where it is not.
    pub fn check(&self, now: Option<&str>) -> Result<(), Problem> {
        let holds = match self {
            Self::IsNew => now.is_none(),
            Self::Exists => now.is_some(),
            Self::Is(tags) => now.is_some_and(|now| tags.iter().any(|tag| tag == now)),
        };
        if holds {
            return Ok(());
        }
        let detail = match now {
            None => "It is not there, or no longer: somebody removed it. Send If-None-Match: * to make it.".to_owned(),
            Some(_) if *self == Self::IsNew => {
                "It is there already: read it, and send its ETag in If-Match to change it.".to_owned()
            }
            Some(now) => format!("Somebody changed it: its ETag is now {}. Read it again, and send that.", quoted(now)),
        };
        let problem = Problem::new(Code::Precondition, "It is another one now", detail);
        Err(match now {
            Some(now) => problem.with("etag", serde_json::json!(quoted(now))).with_header(header::ETAG, &quoted(now)),
            None => problem,
        })
    }
}

fn strong(tags: &str) -> Vec<String> {
    let tags = tags.split(',').map(str::trim);
    tags.filter_map(|tag| tag.strip_prefix('"')?.strip_suffix('"')).map(str::to_owned).collect()
}

/// Does the reader have it already? By `If-None-Match`, where a weak tag counts, too.
pub fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    let known = headers.get(header::IF_NONE_MATCH).and_then(|known| known.to_str().ok()).unwrap_or_default();
    known
        .split(',')
        .map(|known| known.trim().trim_start_matches("W/"))
        .any(|known| known == quoted(tag) || known == "*")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn demand(name: HeaderName, value: &str) -> Demand {
        Demand::of(&HeaderMap::from_iter([(name, value.parse().unwrap())]), "x").unwrap()
    }

    #[test]
    fn a_change_names_what_it_changes() {
        assert!(Demand::of(&HeaderMap::new(), "x").is_err());
        let new = demand(header::IF_NONE_MATCH, "*");
        assert!(new.check(None).is_ok() && new.check(Some("a")).is_err());
        let any = demand(header::IF_MATCH, "*");
        assert!(any.check(Some("a")).is_ok() && any.check(None).is_err());
        let one = demand(header::IF_MATCH, "\"a\", \"b\"");
        assert!(one.check(Some("a")).is_ok() && one.check(Some("b")).is_ok());
        assert!(one.check(Some("c")).is_err() && one.check(None).is_err());
        for weak in ["W/\"a\"", "a", "\"a", "\"\""] {
            assert!(demand(header::IF_MATCH, weak).check(Some("a")).is_err(), "{weak}");
        }
        let both = HeaderMap::from_iter([
            (header::IF_MATCH, "\"a\"".parse().unwrap()),
            (header::IF_NONE_MATCH, "*".parse().unwrap()),
        ]);
        assert!(Demand::of(&both, "x").is_err());
    }
}
