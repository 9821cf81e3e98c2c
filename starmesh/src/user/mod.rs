//! `starmesh user`: the people and programs that the web node lets in.

mod password;
mod token;

use std::path::PathBuf;

use anyhow::{Context as _, anyhow, ensure};
use clap::{Args, Subcommand};
use contract::Name;
use users::{Grant, LastEngineer, PasswordHash, User, Users};

use crate::console::line;
use password::PasswordSource;

/// What `starmesh user` does.
#[derive(Debug, Subcommand)]
pub enum UserCommand {
    /// Let somebody in; asks for the password. From the first user on, everybody has to log in.
    Add(Add),
    /// The users and their rights.
    List(UsersFile),
    /// Give a user another password; their sessions end.
    Password(NewPassword),
    /// Give a user other rights, in place of those before.
    Right(NewRights),
    /// Let a user in no more; their sessions end, and their tokens are removed.
    Remove(Remove),
    /// Tokens, by which programs act for a user.
    #[command(subcommand)]
    Token(token::TokenCommand),
}

/// Where the users are: in the file that `[web] users` of this configuration names.
#[derive(Debug, Args)]
pub struct UsersFile {
    /// The configuration of the web node.
    #[arg(long, default_value = "observatory.toml", value_name = "FILE")]
    config: PathBuf,
}

impl UsersFile {
    fn observatory(&self) -> anyhow::Result<config::Observatory> {
        let config = node::configuration::read_observatory(&self.config);
        config.context("the users file is named by [web] users of the web node's configuration; name that by --config")
    }

    fn path(&self) -> anyhow::Result<PathBuf> {
        Ok(self.observatory()?.web.users)
    }

    /// Prints which rights are for no telescope that the configuration names: a slip of the keyboard gives a right to nothing.
    fn print_strange(&self, grants: &[Grant]) -> anyhow::Result<()> {
        let own = self.observatory()?.address();
        let is_strange = |grant: &&Grant| !grant.is_for(&own) && !grant.is_for(&own.shared());
        for grant in grants.iter().filter(is_strange) {
            let file = self.config.display();
            line(format_args!(
                "warning: {grant} is not for {own}, the telescope of {file}; if it is for no other telescope of your network, correct \
                 it with `starmesh user right`"
            ))?;
        }
        Ok(())
    }

    fn read(&self) -> anyhow::Result<(PathBuf, Users)> {
        let path = self.path()?;
        let users = users::read(&path)?;
        let users =
            users.ok_or_else(|| anyhow!("there is no {} yet: `starmesh user add NAME` makes it", path.display()))?;
        Ok((path, users))
    }

    /// Changes the users; what `change` refuses changes nothing, nor is the last engineer taken away.
    fn edit<T>(&self, change: impl FnOnce(&mut Users) -> anyhow::Result<T>) -> anyhow::Result<T> {
        let path = self.path()?;
        let done = users::edit(&path, |users| users.keeping_engineer(change));
        done.map_err(|error: anyhow::Error| match error.is::<LastEngineer>() {
            true => anyhow!(
                "{error}, by `starmesh user add NAME --right engineer` or `starmesh user right NAME engineer`. To have no users \
                 any more, remove {} and start the web node again, with web.listen on 127.0.0.1: it serves programs of its own \
                 host then, and nobody else",
                path.display()
            ),
            false => error,
        })
    }

    /// Changes one user who is there.
    fn change(&self, name: &Name, change: impl FnOnce(&mut User)) -> anyhow::Result<()> {
        self.edit(|users| {
            change(users.users.get_mut(name).ok_or_else(|| unknown(name))?);
            Ok(())
        })
    }
}

/// Options of `starmesh user add`.
#[derive(Debug, Args)]
pub struct Add {
    /// The name to log in with: letters, digits, '_', '-' or '.'.
    name: Name,
    /// viewer, observer, operator or engineer, alone or with the telescopes that it is for, such as operator:paranal/*.
    #[arg(long = "right", value_name = "RIGHT", required = true)]
    rights: Vec<Grant>,
    #[command(flatten)]
    password: PasswordSource,
    #[command(flatten)]
    file: UsersFile,
}

/// Options of `starmesh user password`.
#[derive(Debug, Args)]
pub struct NewPassword {
    /// Whose.
    name: Name,
    #[command(flatten)]
    password: PasswordSource,
    #[command(flatten)]
    file: UsersFile,
}

/// Options of `starmesh user right`.
#[derive(Debug, Args)]
pub struct NewRights {
    /// Whose.
    name: Name,
    /// All rights that the user has from now on, such as viewer operator:paranal/callisto.
    #[arg(required = true, value_name = "RIGHT")]
    rights: Vec<Grant>,
    #[command(flatten)]
    file: UsersFile,
}

/// Options of `starmesh user remove`.
#[derive(Debug, Args)]
pub struct Remove {
    /// Whom.
    name: Name,
    #[command(flatten)]
    file: UsersFile,
}

/// Does it; the web node follows within two seconds.
///
/// # Errors
/// What is refused, and why.
pub fn run(command: UserCommand) -> anyhow::Result<()> {
    match command {
        UserCommand::Add(options) => add(options),
        UserCommand::List(file) => list(&file),
        UserCommand::Password(NewPassword { name, password, file }) => {
            ensure!(file.read()?.1.users.contains_key(&name), unknown(&name));
            let hash = PasswordHash::of_new(&password.get(&name)?, name.as_str())?;
            file.change(&name, |user| user.password = hash)?;
            line(format_args!("{name} has another password; who was logged in as {name} is logged out"))
        }
        UserCommand::Right(NewRights { name, rights, file }) => {
            file.change(&name, |user| user.grants.clone_from(&rights))?;
            line(format_args!("{name} is {} from now on", shown(&rights)))?;
            file.print_strange(&rights)
        }
        UserCommand::Remove(Remove { name, file }) => remove(&name, &file),
        UserCommand::Token(command) => token::run(command),
    }
}

fn add(options: Add) -> anyhow::Result<()> {
    let Add { name, rights, password, file } = options;
    let path = file.path()?;
    let before = users::read(&path)?.unwrap_or_default();
    // Once before the password is asked for, and once when it is written.
    before.is_free(&name)?;
    let hash = PasswordHash::of_new(&password.get(&name)?, name.as_str())?;
    let has_engineer = file.edit(|users| {
        users.is_free(&name)?;
        users.users.insert(name.clone(), User { password: hash, grants: rights.clone() });
        Ok(users.has_engineer())
    })?;
    line(format_args!("{name} may log in as {} ({})", shown(&rights), path.display()))?;
    file.print_strange(&rights)?;
    if before.users.is_empty() {
        line(format_args!("from now on everybody has to log in at the page, also on this host"))?;
    }
    if !has_engineer {
        line(format_args!(
            "nobody is an engineer of all telescopes yet, so nobody changes users on the page: `starmesh user right {name} engineer` \
             makes one"
        ))?;
    }
    Ok(())
}

fn list(file: &UsersFile) -> anyhow::Result<()> {
    let (path, users) = file.read()?;
    for (name, user) in &users.users {
        let tokens = users.tokens.values().filter(|token| token.user == *name).count();
        let tokens = if tokens == 0 { String::new() } else { format!("  ({tokens} tokens)") };
        line(format_args!("{:<20} {}{tokens}", name.as_str(), shown(&user.grants)))?;
    }
    if users.users.is_empty() {
        line(format_args!("{} has no user, so that nobody can log in", path.display()))?;
    }
    Ok(())
}

fn remove(name: &Name, file: &UsersFile) -> anyhow::Result<()> {
    let (tokens, left) = file.edit(|users| {
        let tokens = users.tokens.values().filter(|token| token.user == *name).count();
        ensure!(users.remove(name), unknown(name));
        Ok((tokens, users.users.len()))
    })?;
    line(format_args!("{name} is removed, with {tokens} tokens"))?;
    if left == 0 {
        line(format_args!("there is no user left, so that nobody can log in"))?;
    }
    Ok(())
}

fn unknown(name: &Name) -> anyhow::Error {
    anyhow!("there is no user {name}; `starmesh user list` shows all")
}

fn shown(rights: &[Grant]) -> String {
    rights.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}
