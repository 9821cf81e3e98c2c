//! `starmesh user token`: by which programs act for a user.

use std::time::Duration;

use anyhow::{anyhow, bail, ensure};
use bus::Clock;
use clap::{Args, Subcommand};
use contract::Name;
use users::Grant;

use super::{UsersFile, shown, unknown};
use crate::console::line;

/// What `starmesh user token` does.
#[derive(Debug, Subcommand)]
pub enum TokenCommand {
    /// Make a token, and print it this once.
    Add(AddToken),
    /// The tokens, without their secrets.
    List(UsersFile),
    /// Take a token away; it is refused within two seconds.
    Remove(RemoveToken),
}

/// Options of `starmesh user token add`.
#[derive(Debug, Args)]
pub struct AddToken {
    /// For whom it acts.
    user: Name,
    /// What it is for, such as cron.
    #[arg(long)]
    name: Name,
    /// It is refused after so many days.
    #[arg(long, default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
    days: u32,
    /// What it may do, of what its user may; all of it where absent.
    #[arg(long = "right", value_name = "RIGHT")]
    rights: Vec<Grant>,
    #[command(flatten)]
    file: UsersFile,
}

/// Options of `starmesh user token remove`.
#[derive(Debug, Args)]
pub struct RemoveToken {
    /// Its name.
    name: Name,
    #[command(flatten)]
    file: UsersFile,
}

/// Does it.
///
/// # Errors
/// What is refused, and why.
pub fn run(command: TokenCommand) -> anyhow::Result<()> {
    match command {
        TokenCommand::Add(options) => add(options),
        TokenCommand::List(file) => list(&file),
        TokenCommand::Remove(RemoveToken { name, file }) => {
            let gone = file.edit(|users| {
                let help = || anyhow!("there is no token {name}; `starmesh user token list` shows all");
                users.tokens.remove(&name).ok_or_else(help)
            })?;
            line(format_args!("token {name} of {} is removed", gone.user))
        }
    }
}

fn add(options: AddToken) -> anyhow::Result<()> {
    let AddToken { user, name, days, rights, file } = options;
    let now = Clock::machine_clock().utc();
    let expires = now.plus(Duration::from_secs(u64::from(days) * 86_400));
    let secret = file.edit(|users| {
        let own = &users.users.get(&user).ok_or_else(|| unknown(&user))?.grants;
        if let Some(more) = rights.iter().find(|grant| !grant.is_within(own)) {
            bail!(
                "{more} is more than {user} may do ({}); give the user the right first, or the token less",
                shown(own)
            );
        }
        ensure!(
            !users.tokens.contains_key(&name),
            "there is a token {name} already; choose another name, or remove it first"
        );
        let rights = (!rights.is_empty()).then(|| rights.clone());
        Ok(users.add_token(name.clone(), user.clone(), rights, now, expires)?)
    })?;
    line(format_args!("{}", secret.reveal()))?;
    node::lines::complain(format_args!(
        "token {name} acts for {user} until {}; it is shown only now. Send it as the header Authorization: Bearer TOKEN",
        expires.strftime("%Y-%m-%d")
    ));
    Ok(())
}

fn list(file: &UsersFile) -> anyhow::Result<()> {
    let (_, users) = file.read()?;
    let now = Clock::machine_clock().utc();
    for (name, token) in &users.tokens {
        let rights = token.grants.as_ref().map_or_else(|| "all of its user".to_owned(), |grants| shown(grants));
        let when = if now >= token.expires_utc { "expired" } else { "until" };
        line(format_args!(
            "{:<20} {:<20} {when} {}  {rights}",
            name.as_str(),
            token.user.as_str(),
            token.expires_utc.strftime("%Y-%m-%d")
        ))?;
    }
    Ok(())
}
