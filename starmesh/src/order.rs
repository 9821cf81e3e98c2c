//! `starmesh order`: what a person may order of one telescope, from any machine on its bus.

use std::ops::ControlFlow;
use std::time::Duration;

use anyhow::{anyhow, bail};
use clap::{Arg, ArgMatches, Args, FromArgMatches, Subcommand, value_parser};
use contract::command::operator;
use contract::observatory::OperatorOrders;
use contract::order_form::{ORDERS, OrderForm, OrderParameter, ParameterValue, check_reason};
use contract::{Address, CommandId, Key, Order, OrderKind, Part, printable};
use orders::{Follower, NotAccepted, NotClosed, NotDone, TakenBy};
use serde_json::{Map, Value, json};

use crate::console::{foreign_line, line};
use crate::join::Join;
use crate::telescopes;

/// Options of `starmesh order`.
#[derive(Debug, Args)]
pub struct Options {
    /// Which telescope, as SITE/TELESCOPE.
    telescope: String,
    #[command(subcommand)]
    what: OrderCommand,
    /// Why, for the log. An override, a shelved alert, and taking over from another operator need it.
    #[arg(long, default_value = "", global = true)]
    reason: String,
    /// The name of the person who orders; by default $STARMESH_OPERATOR, else the name of the account.
    #[arg(long, value_name = "NAME", global = true)]
    operator: Option<String>,
    /// How long to wait until a close order is verified closed, s; 0 does not wait.
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0, global = true)]
    wait: f64,
    /// How long an order that closes is asked for where no observatory node answers, after the domes have closed or were
    /// late, s: one that comes back may open again else. Domes that are late are followed for so long.
    #[arg(long, value_name = "SECONDS", default_value_t = orders::GIVEN_ON.as_secs_f64(), global = true)]
    give_on: f64,
    #[command(flatten)]
    join: Join,
}

/// One order with its parameters, as they stand on the command line.
#[derive(Debug)]
struct OrderCommand {
    form: &'static OrderForm,
    given: Map<String, Value>,
}

/// A whole schedule is put in force by `starmesh schedule put`.
fn forms() -> impl Iterator<Item = &'static OrderForm> {
    let has_document =
        |form: &&OrderForm| form.parameters.iter().any(|parameter| matches!(parameter.value, ParameterValue::Document));
    ORDERS.iter().filter(move |form| !has_document(form))
}

fn argument(parameter: &'static OrderParameter) -> Arg {
    let argument = Arg::new(parameter.name).value_name(parameter.name.to_uppercase()).help(parameter.meaning);
    match parameter.value {
        ParameterValue::Text | ParameterValue::Document => argument.required(true),
        ParameterValue::Whole { min, max } => {
            argument.required(true).value_parser(value_parser!(u32).range(i64::from(min)..=i64::from(max)))
        }
        ParameterValue::OptionalText => argument.long(parameter.name.replace('_', "-")),
        ParameterValue::Number { min, max, default } => {
            let value = move |text: &str| match text.parse::<f64>() {
                Ok(number) if (min..=max).contains(&number) => Ok(number),
                _ => Err(format!("expected a number from {min} to {max}")),
            };
            let argument =
                argument.long(parameter.name.replace('_', "-")).allow_negative_numbers(true).value_parser(value);
            match default {
                Some(default) => argument.default_value(default.to_string()),
                None => argument,
            }
        }
    }
}

impl Subcommand for OrderCommand {
    fn augment_subcommands(command: clap::Command) -> clap::Command {
        command.subcommand_required(true).subcommands(forms().map(|form| {
            let waits = if form.closes {
                " Waits until it is verified closed. Where no observatory node answers, the dome's device node closes."
            } else {
                ""
            };
            let reason = if form.needs_reason { " Needs --reason." } else { "" };
            let about = format!("{}{waits}{reason}", form.meaning);
            clap::Command::new(form.word).about(about).args(form.parameters.iter().map(argument))
        }))
    }

    fn augment_subcommands_for_update(command: clap::Command) -> clap::Command {
        Self::augment_subcommands(command)
    }

    fn has_subcommand(name: &str) -> bool {
        forms().any(|form| form.word == name)
    }
}

impl FromArgMatches for OrderCommand {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let missing = || clap::Error::new(clap::error::ErrorKind::MissingSubcommand);
        let (word, matches) = matches.subcommand().ok_or_else(missing)?;
        let form = OrderForm::of(word).map_err(|_| missing())?;
        let value = |parameter: &OrderParameter| match parameter.value {
            ParameterValue::Text | ParameterValue::OptionalText | ParameterValue::Document => {
                matches.get_one::<String>(parameter.name).map(|text| json!(text))
            }
            ParameterValue::Whole { .. } => matches.get_one::<u32>(parameter.name).map(|number| json!(number)),
            ParameterValue::Number { .. } => matches.get_one::<f64>(parameter.name).map(|number| json!(number)),
        };
        let given = form.parameters.iter().filter_map(|parameter| Some((parameter.name.to_owned(), value(parameter)?)));
        Ok(Self { form, given: given.collect() })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// So long an order is given that nobody answers; a session that has just opened does not know all its peers.
const WITHIN: Duration = Duration::from_secs(10);

/// Gives the order and prints what became of it.
pub async fn run(options: Options) -> anyhow::Result<()> {
    let Options { telescope, what, reason, operator, wait, give_on, join } = options;
    let [verified, heard] = [wait, give_on].map(|time_s| Duration::from_secs_f64(time_s.clamp(0.0, 86_400.0)));
    let kind = what.form.fill(&what.given, &reason)?;
    give(&telescope, kind, By { operator, reason }, Waits { verified, heard }, join).await
}

/// The operator of an order, where a name was given, and the reason.
pub struct By {
    /// The operator's name.
    pub operator: Option<String>,
    /// For the log.
    pub reason: String,
}

/// How long an order that closes is waited for.
#[derive(Clone, Copy, Default)]
pub struct Waits {
    /// Until it is verified closed.
    pub verified: Duration,
    /// After that, until an observatory node that did not answer takes it.
    pub heard: Duration,
}

/// Gives an order to a telescope, named as SITE/TELESCOPE, and prints the result.
pub async fn give(telescope: &str, kind: OrderKind, by: By, waits: Waits, join: Join) -> anyhow::Result<()> {
    check_reason(&by.reason)?;
    let order = Order { id: CommandId::fresh(), from: from(by.operator)?, reason: by.reason, kind, seen: None };
    let bus = join.open().await?;
    let address = telescopes::read(telescope, &bus, &join).await?;
    if closes(&order.kind) {
        close(&bus, &address, &order, waits, &join).await?;
    } else {
        accept(&bus, &address, &order, &join).await?;
        line(format_args!("accepted"))?;
        if matches!(order.kind, OrderKind::Robotic(true)) {
            print_hold(&bus, &address).await?;
        }
    }
    bus.close().await;
    Ok(())
}

/// Gives an order that only the observatory node can execute; again while nobody answers.
async fn accept(bus: &bus::Bus, address: &Address, order: &Order, join: &Join) -> anyhow::Result<()> {
    let unless_mistyped = || async move {
        // A mistyped name is reported at once where others answer.
        let known = telescopes::known(bus).await;
        if known.is_empty() || telescopes::is_known(address, &known, bus).await {
            return ControlFlow::Continue(());
        }
        ControlFlow::Break(telescopes::mistyped(address, &known, join))
    };
    match orders::give_until_answered(bus, address, order, WITHIN, unless_mistyped).await {
        Ok(None) => Ok(()),
        Ok(Some(mistyped)) => Err(mistyped),
        Err(error) if error.is_silence() => Err(telescopes::unanswered(address, bus, join).await),
        Err(error) => Err(refused(&error)),
    }
}

fn refused(error: &NotAccepted) -> anyhow::Error {
    match error {
        NotAccepted::Refused(refusal) => anyhow!("refused, {}: {}", refusal.reason, printable(&refusal.detail)),
        error => anyhow!("{}", printable(&error.to_string())),
    }
}

/// Gives an order that closes, to whoever answers, and prints who takes it and who has closed.
async fn close(bus: &bus::Bus, address: &Address, order: &Order, waits: Waits, join: &Join) -> anyhow::Result<()> {
    let Waits { verified: wait, heard } = waits;
    // The subscriptions begin before the order is given, so that no effect is missed.
    let follower = Follower::open(bus, address).await?;
    let until = match wait.is_zero() {
        true => String::new(),
        false => format!("; waiting until it is verified closed, at most {:.0} s", wait.as_secs_f64()),
    };
    let mut was_silent = false;
    let mut print = |taken: &TakenBy| {
        // A reader that has gone does not keep the telescope from being closed.
        let _ = match taken {
            TakenBy::Observatory | TakenBy::Ended(_) if was_silent => {
                let followed = if until.is_empty() { "" } else { "; waiting until it is verified closed" };
                foreign_line(format_args!("the observatory node of {address} answers now: accepted{followed}"))
            }
            TakenBy::Observatory | TakenBy::Ended(_) => line(format_args!("accepted{until}")),
            TakenBy::Domes(domes) => {
                was_silent = true;
                let domes: Vec<String> = domes.iter().map(ToString::to_string).collect();
                let domes = domes.join(", ");
                foreign_line(format_args!(
                    "no observatory node of {address} has answered yet: the device node of {domes} was ordered to close{until}"
                ))
            }
        };
    };
    let late = |late: &NotClosed| {
        let goes_on = format!("This order is followed and asked for {} s more", heard.as_secs());
        let _ = foreign_line(format_args!("{late}. {goes_on}"));
    };
    let mut taken = match orders::close_and_go_on(bus, &follower, order, (wait, heard), &mut print, late).await {
        Ok(taken) => taken,
        Err(NotDone::NotAccepted(error)) if error.is_silence() => {
            return Err(telescopes::unanswered(address, bus, join).await);
        }
        Err(NotDone::NotAccepted(error)) => return Err(refused(&error)),
        Err(error) => bail!("{}", printable(&error.to_string())),
    };
    loop {
        if !wait.is_zero() {
            line(format_args!("{}", taken.closed_words()))?;
        }
        let Some(warning) = taken.warning() else { return Ok(()) };
        line(format_args!("but {warning}. It is asked for {} s more", heard.as_secs()))?;
        taken = match orders::give_on(bus, &follower, order, (heard, wait), &mut print).await {
            Ok(taken) => taken,
            Err(NotDone::NotAccepted(error)) if error.is_silence() => {
                bail!("it was only closed: no observatory node answers")
            }
            Err(NotDone::NotAccepted(error)) => return Err(refused(&error)),
            Err(error @ NotDone::Replaced(_)) => bail!("it was only closed: {}", printable(&error.to_string())),
            Err(error @ (NotDone::NotClosed(_) | NotDone::NotWritten { .. })) => {
                bail!("{}", printable(&error.to_string()))
            }
        };
    }
}

/// Prints the operator who ordered that the telescope stays closed, if there is such an order: a start opens nothing
/// then.
async fn print_hold(bus: &bus::Bus, address: &Address) -> anyhow::Result<()> {
    let key = Key::Observatory(address.clone(), Part::OperatorOrders).to_string();
    for (_, sample) in bus.get_all::<OperatorOrders>(&key, Duration::from_secs(1)).await {
        if let Some(hold) = sample.body.stay_closed {
            let reason = if hold.reason.is_empty() { "no reason given" } else { &hold.reason };
            foreign_line(format_args!(
                "it stays closed all the same: {} ordered so at {} ({reason}). `starmesh order {address} open-again` takes that back, \
                 and then it opens",
                operator(&hold.from),
                hold.at_utc.to_second()
            ))?;
        }
    }
    Ok(())
}

/// The name of an operator at a command line: `cli/ana@dome-pc`.
fn from(operator: Option<String>) -> anyhow::Result<String> {
    let variable = |name: &str| std::env::var(name).ok().filter(|value| !value.trim().is_empty());
    let account = || {
        variable("STARMESH_OPERATOR").or_else(|| variable("USER")).or_else(|| variable("USERNAME")).or_else(of_account)
    };
    let name = operator.or_else(account).unwrap_or_default();
    let name = name.trim();
    if name.is_empty() || name.contains(['/', '@']) || name.chars().any(char::is_control) {
        bail!("who orders? expected --operator NAME, without '/' and '@', such as --operator ana; got {name:?}");
    }
    Ok(format!("cli/{name}@{}", node::host_name()).trim_end_matches('@').to_owned())
}

/// The name of this process's account where its environment does not contain it, as in a container.
fn of_account() -> Option<String> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let uid = status.lines().find_map(|line| line.strip_prefix("Uid:"))?.split_whitespace().next()?.to_owned();
    let accounts = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let mut names = accounts.lines().filter_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)? == uid).then(|| name.to_owned())
    });
    Some(names.next().unwrap_or_else(|| format!("uid-{uid}")))
}

fn closes(kind: &OrderKind) -> bool {
    matches!(kind, OrderKind::Close | OrderKind::Robotic(false) | OrderKind::StayClosed(true))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_orders_is_named_with_the_way_and_the_host() {
        let signed = from(Some(" ana ".to_owned())).unwrap();
        assert!(signed.starts_with("cli/ana"), "{signed}");
        assert_eq!(contract::command::operator(&signed), "ana");
        for bad in ["", " ", "a/b", "a@b", "a\nb"] {
            assert!(from(Some(bad.to_owned())).is_err(), "{bad:?}");
        }
        #[cfg(target_os = "linux")]
        assert!(!of_account().unwrap().is_empty(), "an account has a name or a number");
    }
}
