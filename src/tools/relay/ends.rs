//! The two ends of a relay on the command line: connecting or listening, in the given order.
//!
//! The order matters, because a profile distinguishes the brick's end from the station's; a derived parser would lose it.

use clap::error::ErrorKind;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, Error, FromArgMatches};

use crate::flags::StationLink;

const CALLED: &str = "url";
const AWAITED: &str = "listen";

#[derive(Clone, Debug)]
pub struct RelayEnds {
    pub brick: StationLink,
    pub station: StationLink,
}

impl Args for RelayEnds {
    fn augment_args(command: Command) -> Command {
        command
            .arg(
                Arg::new(CALLED)
                    .value_name("URL")
                    .num_args(0..)
                    .action(ArgAction::Append)
                    .help("Connect to this link. The first link goes to the robot, the second to the station"),
            )
            .arg(
                Arg::new(AWAITED)
                    .long(AWAITED)
                    .value_name("URL")
                    .action(ArgAction::Append)
                    .help("Wait for a connection on this link. It counts at its position among the links"),
            )
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for RelayEnds {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let call = |url: &String| StationLink { listen: None, link: Some(url.clone()) };
        let wait = |url: &String| StationLink { listen: Some(url.clone()), link: None };
        let mut ends = ends_in_order(matches, CALLED, call);
        ends.extend(ends_in_order(matches, AWAITED, wait));
        ends.sort_by_key(|(index, _)| *index);
        let ends: Vec<StationLink> = ends.into_iter().map(|(_, end)| end).collect();
        let count = ends.len();
        match <[StationLink; 2]>::try_from(ends) {
            Ok([brick, station]) => Ok(Self { brick, station }),
            Err(_) => Err(Error::raw(
                ErrorKind::WrongNumberOfValues,
                format!(
                    "a relay has two ends and was given {count}: URL calls a link, --listen URL waits on one; \
                     the brick's end comes first\n"
                ),
            )),
        }
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// The values of an argument with their positions on the command line.
fn ends_in_order(matches: &ArgMatches, id: &str, end: impl Fn(&String) -> StationLink) -> Vec<(usize, StationLink)> {
    let indices = matches.indices_of(id).into_iter().flatten();
    let values = matches.get_many::<String>(id).into_iter().flatten();
    indices.zip(values.map(end)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(words: &[&str]) -> Result<RelayEnds, Error> {
        let matches = RelayEnds::augment_args(Command::new("relay")).try_get_matches_from(words)?;
        RelayEnds::from_arg_matches(&matches)
    }

    #[test]
    fn the_first_link_is_the_bricks_however_it_is_opened() {
        let ends = parse(&["relay", "--listen", "tcp://:1", "udp://host:2"]).unwrap();
        assert_eq!(ends.brick.listen.as_deref(), Some("tcp://:1"));
        assert_eq!(ends.station.link.as_deref(), Some("udp://host:2"));
        let ends = parse(&["relay", "serial:/dev/ttyUSB0", "--listen", "tcp://:1"]).unwrap();
        assert_eq!(ends.brick.link.as_deref(), Some("serial:/dev/ttyUSB0"));
        assert_eq!(ends.station.listen.as_deref(), Some("tcp://:1"));
    }

    #[test]
    fn one_end_or_three_are_refused() {
        for words in [&["relay", "udp://:1"][..], &["relay", "a", "b", "--listen", "c"]] {
            assert!(parse(words).is_err(), "{words:?}");
        }
    }
}
