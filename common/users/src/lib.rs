//! Users and what they may do: the rights of people and programs on telescopes, and the file that holds them.
//!
//! A [`Principal`] is the caller of an interface, with the [`Grant`]s that its user has. A grant gives one [`Right`] on a part of the
//! network, such as `operator` on `paranal/*`. Each right contains those below it.
//!
//! [`Users`] is what the users file has: passwords as argon2id hashes, tokens as SHA-256. [`edit`] changes it and
//! [`WatchedUsers`] follows it.
//!
//! # Invariants
//!
//! - What no grant gives is refused: `a_grant_reaches_exactly_what_it_names`.
//! - A token never gives more than its user has: `a_token_gives_what_it_and_its_user_have_until_it_expires_or_the_user_is_gone`.
//! - Neither a file that is damaged nor one that is gone lets anybody in who was not let in before (decision 0110):
//!   `a_damaged_file_leaves_the_users_before_it_and_a_missing_one_nobody`,
//!   `a_file_that_was_damaged_from_the_beginning_lets_nobody_in`.
//! - The last engineer of all telescopes stays one, by whatever interface:
//!   `the_last_engineer_of_all_telescopes_stays_one_and_a_file_without_one_is_changed_as_before`.
//! - No secret is shown by accident: `a_secret_is_never_shown_by_itself_and_no_two_are_alike`,
//!   `what_is_written_is_read_again_and_holds_no_secret`.

mod file;
mod grant;
mod password;
mod principal;
mod secret;
mod users;

pub use contract::Right;

pub use file::{FileFault, WatchedUsers, edit, read};
pub use grant::{BadGrant, Grant};
pub use password::{PasswordFault, PasswordHash};
pub use principal::{Principal, Way};
pub use secret::{NoRandomness, Secret, SecretHash};
pub use users::{LastEngineer, NameFault, Token, TokenFault, User, Users, UsersFault};
