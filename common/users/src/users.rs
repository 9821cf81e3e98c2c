//! The users of a page with their tokens, as the users file has them.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use contract::Name;
use serde::{Deserialize, Serialize};
use toml::Spanned;
use units::Utc;

use crate::password::{self, PasswordHash};
use crate::secret::{Secret, SecretHash};
use crate::{Grant, Principal, Right, Way};

/// Larger files are none of ours.
pub(crate) const MOST_BYTES: u64 = 1 << 20;
const TOKEN_PREFIX: &str = "starmesh_";
/// Names by which logs and the API show somebody who is no user.
const RESERVED: [&str; 4] = ["local", "anybody", "nobody", "public"];
const HEAD: &str = "# Users of the page and the API, and their tokens. `starmesh user` writes this file and keeps no comments;\n\
                    # docs/operator/users.md explains it. It holds no password and no token, only what proves them.\n";

/// A person who may log in.
#[derive(Debug, Clone, PartialEq)]
pub struct User {
    /// The hash of the password.
    pub password: PasswordHash,
    /// What the user may do.
    pub grants: Vec<Grant>,
}

/// What a program presents instead of a password.
#[derive(Debug, Clone, PartialEq)]
pub struct Token {
    /// For whom it acts.
    pub user: Name,
    /// What is stored of it.
    pub hash: SecretHash,
    /// The rights that it has of those of its user; all where absent.
    pub grants: Option<Vec<Grant>>,
    /// When it was made.
    pub made_utc: Utc,
    /// From when on it is refused.
    pub expires_utc: Utc,
}

/// All users and tokens.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Users {
    /// By name.
    pub users: BTreeMap<Name, User>,
    /// By name.
    pub tokens: BTreeMap<Name, Token>,
}

/// Why the text of a users file is not taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {what}")]
pub struct UsersFault {
    /// From 1.
    pub line: usize,
    /// What is wrong, and what was expected.
    pub what: String,
}

/// Why a new user cannot have a name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameFault {
    /// It means somebody who is no user.
    #[error("{0} is the name of those who are no users; choose another")]
    Reserved(Name),
    /// There is such a user.
    #[error("there is a user {0} already; change this one, or choose another name")]
    Taken(Name),
    /// People would mix them up.
    #[error("there is a user {known}, whom {name} could be taken for; choose another name")]
    Alike {
        /// What was asked for.
        name: Name,
        /// Who is there.
        known: Name,
    },
}

/// A change would leave nobody who may change users.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "nobody else is an engineer of all telescopes, and without one nobody changes users on the page: make another engineer first"
)]
pub struct LastEngineer;

/// Why a token gives nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TokenFault {
    /// There is none such, or it was removed.
    #[error("there is no such token; it may have been removed, or its user")]
    Unknown,
    /// Its time is over.
    #[error("the token has expired; make a new one with `starmesh user token add`")]
    Expired,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ReadFile {
    /// Not optional: a file that ends before it was not written to its end.
    user: Vec<Spanned<UserRow>>,
    #[serde(default)]
    token: Vec<Spanned<TokenRow>>,
}

#[derive(Serialize)]
struct WrittenFile {
    user: Vec<UserRow>,
    token: Vec<TokenRow>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct UserRow {
    name: Name,
    rights: Vec<Grant>,
    password: String,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct TokenRow {
    name: Name,
    user: Name,
    #[serde(skip_serializing_if = "Option::is_none")]
    rights: Option<Vec<Grant>>,
    made_utc: Utc,
    expires_utc: Utc,
    sha256: String,
}

impl Users {
    /// Reads the text of a users file.
    ///
    /// # Errors
    /// The first thing that is wrong, with its line; never a hash.
    pub fn parse(text: &str) -> Result<Self, UsersFault> {
        let line_at = |byte: usize| 1 + text.bytes().take(byte).filter(|b| *b == b'\n').count();
        let read: ReadFile = toml::from_str(text).map_err(|error| {
            let line = error.span().map_or(1, |span| line_at(span.start));
            // The whole error quotes the line, which may hold a hash.
            UsersFault { line, what: error.message().replace('`', "\"") }
        })?;
        let mut all = Self::default();
        for row in read.user {
            let fault = |what: String| UsersFault { line: line_at(row.span().start), what };
            let UserRow { name, rights, password } = row.get_ref();
            if rights.is_empty() {
                return Err(fault(format!("user {name} has no right: expected rights = [\"viewer\"] or more")));
            }
            let password =
                PasswordHash::parse(password).map_err(|what| fault(format!("password of user {name}: {what}")))?;
            let user = User { password, grants: rights.clone() };
            if all.users.insert(name.clone(), user).is_some() {
                return Err(fault(format!("two users are named {name}: give one another name")));
            }
        }
        for row in read.token {
            let fault = |what: String| UsersFault { line: line_at(row.span().start), what };
            let TokenRow { name, user, rights, made_utc, expires_utc, sha256 } = row.get_ref();
            let hash = SecretHash::parse(sha256)
                .ok_or_else(|| fault(format!("sha256 of token {name}: expected 64 hexadecimal digits")))?;
            let token = Token {
                user: user.clone(),
                hash,
                grants: rights.clone(),
                made_utc: *made_utc,
                expires_utc: *expires_utc,
            };
            if all.tokens.insert(name.clone(), token).is_some() {
                return Err(fault(format!("two tokens are named {name}: give one another name")));
            }
        }
        Ok(all)
    }

    /// As text for the file.
    ///
    /// # Errors
    /// Never, for what was read or made here.
    pub(crate) fn to_text(&self) -> Result<String, toml::ser::Error> {
        let users = self.users.iter().map(|(name, user)| UserRow {
            name: name.clone(),
            rights: user.grants.clone(),
            password: user.password.text().to_owned(),
        });
        let tokens = self.tokens.iter().map(|(name, token)| TokenRow {
            name: name.clone(),
            user: token.user.clone(),
            rights: token.grants.clone(),
            made_utc: token.made_utc,
            expires_utc: token.expires_utc,
            sha256: token.hash.to_string(),
        });
        let mut text = HEAD.to_owned();
        let rows = toml::to_string(&WrittenFile { user: users.collect(), token: tokens.collect() })?;
        // writing to a string does not fail
        let _ = write!(text, "\n{rows}");
        Ok(text)
    }

    /// May a new user have this name? Nobody shall be taken for somebody else, also where case is ignored.
    ///
    /// # Errors
    /// Why not.
    pub fn is_free(&self, name: &Name) -> Result<(), NameFault> {
        if RESERVED.contains(&name.as_str()) {
            return Err(NameFault::Reserved(name.clone()));
        }
        match self.users.keys().find(|known| known.as_str().eq_ignore_ascii_case(name.as_str())) {
            Some(known) if known == name => Err(NameFault::Taken(name.clone())),
            Some(known) => Err(NameFault::Alike { name: name.clone(), known: known.clone() }),
            None => Ok(()),
        }
    }

    /// Is there somebody who may change users?
    pub fn has_engineer(&self) -> bool {
        self.users.values().any(|user| user.grants.contains(&Grant::everywhere(Right::Engineer)))
    }

    /// Changes them so that somebody remains who may change users. A file that never had an engineer is served as it is.
    ///
    /// # Errors
    /// What `change` refuses, and [`LastEngineer`]: then these users may be changed all the same, and must not be stored.
    pub fn keeping_engineer<T, E: From<LastEngineer>>(
        &mut self,
        change: impl FnOnce(&mut Self) -> Result<T, E>,
    ) -> Result<T, E> {
        let had_one = self.has_engineer();
        let done = change(self)?;
        if had_one && !self.has_engineer() {
            return Err(LastEngineer.into());
        }
        Ok(done)
    }

    /// The user of this name.
    pub fn user(&self, name: &str) -> Option<(&Name, &User)> {
        let name: Name = name.parse().ok()?;
        self.users.get_key_value(&name)
    }

    /// The user with this name and password. It takes some 20 ms of one core, whether there is such a user or not.
    pub fn log_in(&self, name: &str, password: &str) -> Option<(&Name, &User)> {
        let known = self.user(name);
        password::verify(password, known.map(|(_, user)| &user.password)).then_some(known).flatten()
    }

    /// Makes a token; what is returned is the only copy of it.
    ///
    /// # Errors
    /// The system gives no random numbers.
    pub fn add_token(
        &mut self,
        name: Name,
        user: Name,
        grants: Option<Vec<Grant>>,
        made_utc: Utc,
        expires_utc: Utc,
    ) -> Result<Secret, crate::NoRandomness> {
        let secret = Secret::fresh(TOKEN_PREFIX)?;
        self.tokens.insert(name, Token { user, hash: secret.hash(), grants, made_utc, expires_utc });
        Ok(secret)
    }

    /// Takes a user away, with their tokens; true when there was one.
    pub fn remove(&mut self, name: &Name) -> bool {
        self.tokens.retain(|_, token| token.user != *name);
        self.users.remove(name).is_some()
    }

    /// The principal of a token with this hash: its user, with no more than the rights that both have now.
    ///
    /// # Errors
    /// The token is not known, or has expired.
    pub fn of_token(&self, hash: SecretHash, now: Utc) -> Result<Principal, TokenFault> {
        let token = self.tokens.values().find(|token| token.hash == hash).ok_or(TokenFault::Unknown)?;
        let user = self.users.get(&token.user).ok_or(TokenFault::Unknown)?;
        if now >= token.expires_utc {
            return Err(TokenFault::Expired);
        }
        let grants = match &token.grants {
            None => user.grants.clone(),
            Some(own) => own.iter().flat_map(|own| user.grants.iter().filter_map(|grant| grant.meet(own))).collect(),
        };
        Ok(Principal { name: token.user.to_string(), way: Way::Token, grants })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    const PASSWORD: &str = "four plain words here";

    fn utc(text: &str) -> Utc {
        text.parse().unwrap()
    }

    fn name(text: &str) -> Name {
        text.parse().unwrap()
    }

    /// Ana, an operator of paranal, with a token.
    pub(crate) fn ana() -> (Users, Secret) {
        let mut users = Users::default();
        let password = PasswordHash::of_new(PASSWORD, "ana").unwrap();
        let grants = vec!["operator:paranal/*".parse().unwrap()];
        users.users.insert(name("ana"), User { password, grants });
        let (made, expires) = (utc("2026-11-25T00:00:00Z"), utc("2027-11-25T00:00:00Z"));
        let secret =
            users.add_token(name("cron"), name("ana"), Some(vec![Grant::everywhere(Right::Viewer)]), made, expires);
        (users, secret.unwrap())
    }

    #[test]
    fn what_is_written_is_read_again_and_holds_no_secret() {
        let (users, secret) = ana();
        let text = users.to_text().unwrap();
        assert_eq!(Users::parse(&text).unwrap(), users);
        assert!(!text.contains(secret.reveal()) && !text.contains(PASSWORD), "{text}");
        let shown = format!("{users:?}");
        assert!(!shown.contains("$argon2") && !shown.contains(&secret.hash().to_string()), "{shown}");
        let none = Users::default();
        assert_eq!(Users::parse(&none.to_text().unwrap()).unwrap(), none);
        assert!(Users::parse("").is_err() && Users::parse(HEAD).is_err(), "cut off before the first user");
    }

    #[test]
    fn a_strange_file_is_refused_with_its_line_and_without_its_hashes() {
        let (users, _) = ana();
        let text = users.to_text().unwrap();
        let hash = users.users[&name("ana")].password.text().to_owned();
        let line_of = |part: &str| 1 + text[..text.find(part).unwrap()].matches('\n').count();
        for (from, to, at, what) in [
            ("rights = [\"op", "right = [\"op", "rights = [\"op", "unknown field"),
            ("\"operator:paranal/*\"", "\"root\"", "\"operator:", "is no grant"),
            ("rights = [\"operator:paranal/*\"]", "rights = []", "[[user]]", "has no right"),
            ("$argon2id", "$argon3id", "[[user]]", "password of user ana"),
            ("name = \"ana\"", "name = \"a/a\"", "name = \"ana\"", "is no name"),
            ("sha256 = \"", "sha256 = \"x", "[[token]]", "64 hexadecimal digits"),
            ("expires_utc = \"", "expires_utc = \"x", "expires_utc", "is no time"),
            ("[[token]]", "[[tokens]]", "[[token]]", "unknown field"),
            ("[[token]]", "[[token]", "[[token]]", ""),
        ] {
            assert!(text.contains(from), "{from}");
            let fault = Users::parse(&text.replacen(from, to, 1)).unwrap_err();
            assert!(fault.line == line_of(at) && fault.what.contains(what), "{from} {to}: {fault}");
            assert!(!fault.to_string().contains(&hash[20..]), "{fault}");
        }
        let again = text.replacen(
            "[[token]]",
            &format!("[[user]]\nname = \"ana\"\nrights = [\"viewer\"]\npassword = \"{hash}\"\n[[token]]"),
            1,
        );
        assert!(Users::parse(&again).unwrap_err().what.contains("two users are named ana"));
        // a file that ends early anywhere is refused or has less, and never more
        for end in (0..text.len()).filter(|end| text.is_char_boundary(*end)) {
            if let Ok(part) = Users::parse(&text[..end]) {
                assert!(part.users.iter().all(|(name, user)| users.users.get(name) == Some(user)), "{end}");
            }
        }
    }

    #[test]
    fn a_token_gives_what_it_and_its_user_have_until_it_expires_or_the_user_is_gone() {
        let (mut users, secret) = ana();
        let now = utc("2026-12-01T00:00:00Z");
        let principal = users.of_token(secret.hash(), now).unwrap();
        assert_eq!((principal.name.as_str(), principal.way), ("ana", Way::Token));
        assert_eq!(principal.grants, ["viewer:paranal/*".parse().unwrap()], "the lesser of both");
        assert_eq!(users.of_token(Secret::fresh("").unwrap().hash(), now), Err(TokenFault::Unknown));
        assert_eq!(users.of_token(secret.hash(), utc("2027-11-25T00:00:00Z")), Err(TokenFault::Expired));
        users.users.get_mut(&name("ana")).unwrap().grants = vec!["engineer:teide/*".parse().unwrap()];
        assert_eq!(users.of_token(secret.hash(), now).unwrap().grants, ["viewer:teide/*".parse().unwrap()]);
        let mut edited = users.clone();
        edited.users.clear();
        assert_eq!(edited.of_token(secret.hash(), now), Err(TokenFault::Unknown), "removed by hand");
        assert!(users.remove(&name("ana")) && users.tokens.is_empty() && !users.remove(&name("ana")));
    }

    #[test]
    fn only_the_right_password_logs_in() {
        let (users, _) = ana();
        assert_eq!(users.log_in("ana", PASSWORD).unwrap().0.as_str(), "ana");
        for (name, password) in [
            ("ana", ""),
            ("ana", "four plain words herE"),
            ("Ana", PASSWORD),
            ("bob", PASSWORD),
            ("", ""),
            ("a/b", PASSWORD),
        ] {
            assert!(users.log_in(name, password).is_none(), "{name}");
        }
    }

    #[test]
    fn a_new_user_has_a_name_that_nobody_has_and_that_means_nobody_else() {
        let (mut users, _) = ana();
        assert!(users.is_free(&name("bob")).is_ok() && !users.has_engineer());
        for (taken, why) in [("ana", "already"), ("ANA", "could be taken for"), ("local", "those who are no users")] {
            assert!(users.is_free(&name(taken)).unwrap_err().to_string().contains(why), "{taken}");
        }
        for (right, has) in [("engineer:paranal/*", false), ("operator", false), ("engineer", true)] {
            users.users.get_mut(&name("ana")).unwrap().grants = vec![right.parse().unwrap()];
            assert_eq!(users.has_engineer(), has, "{right}");
        }
    }

    #[test]
    fn the_last_engineer_of_all_telescopes_stays_one_and_a_file_without_one_is_changed_as_before() {
        let (mut users, _) = ana();
        let give = |name: &str, right: &str| {
            let (name, grants) = (self::name(name), vec![right.parse().unwrap()]);
            move |users: &mut Users| {
                users.users.get_mut(&name).unwrap().grants = grants;
                Ok::<_, LastEngineer>(())
            }
        };
        let gone = |name: &str| {
            let name = self::name(name);
            move |users: &mut Users| Ok::<_, LastEngineer>(users.remove(&name))
        };
        users.users.insert(name("bob"), users.users[&name("ana")].clone());
        assert_eq!(users.clone().keeping_engineer(gone("ana")), Ok(true), "nobody was one");
        users.keeping_engineer(give("ana", "engineer")).unwrap();
        for right in ["viewer", "engineer:paranal/*"] {
            assert!(users.clone().keeping_engineer(give("ana", right)).is_err(), "{right}");
        }
        assert_eq!(users.clone().keeping_engineer(gone("ana")), Err(LastEngineer));
        assert_eq!(users.clone().keeping_engineer(gone("bob")), Ok(true));
        users.keeping_engineer(give("bob", "engineer")).unwrap();
        assert_eq!(users.keeping_engineer(gone("ana")), Ok(true), "another one is there");
    }
}
