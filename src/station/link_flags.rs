//! `--link URL` and `--listen URL`: the links of a run, in the order of the command line.
//!
//! `--brick` applies to the first of them, and reports number them, so their order must not depend on which end connects. A derived
//! parser keeps the order within one flag only.

use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use posebridge_link::ConnectRole;

const FLAGS: [(&str, ConnectRole, &str); 2] = [
    ("link", ConnectRole::Dial, "Connect to this link. Can be repeated. Replaces the links of the configuration"),
    ("listen", ConnectRole::Listen, "Wait for a connection on this link. Can be repeated"),
];

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkFlag {
    pub url: String,
    pub role: ConnectRole,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LinkFlags(pub Vec<LinkFlag>);

impl LinkFlags {
    fn push_matches(&mut self, matches: &ArgMatches) {
        let mut indexed = Vec::new();
        for (name, role, _) in FLAGS {
            let urls = matches.get_many::<String>(name).unwrap_or_default();
            let indices = matches.indices_of(name).into_iter().flatten();
            let flags = urls.map(|url| LinkFlag { url: url.clone(), role });
            indexed.extend(indices.zip(flags));
        }
        indexed.sort_by_key(|(index, _)| *index);
        self.0 = indexed.into_iter().map(|(_, flag)| flag).collect();
    }
}

impl FromArgMatches for LinkFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut flags = Self::default();
        flags.push_matches(matches);
        Ok(flags)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.push_matches(matches);
        Ok(())
    }
}

impl Args for LinkFlags {
    fn augment_args(command: Command) -> Command {
        command.args(
            FLAGS.map(|(name, _, help)| {
                Arg::new(name).long(name).value_name("URL").action(ArgAction::Append).help(help)
            }),
        )
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_stand_in_the_order_of_the_command_line() {
        let command = LinkFlags::augment_args(Command::new("run"));
        let line = ["run", "--listen", "a", "--link", "b", "--link", "c", "--listen", "d"];
        let matches = command.try_get_matches_from(line).unwrap();
        let flags = LinkFlags::from_arg_matches(&matches).unwrap();
        let order: Vec<(&str, ConnectRole)> = flags.0.iter().map(|flag| (flag.url.as_str(), flag.role)).collect();
        let expected = [
            ("a", ConnectRole::Listen),
            ("b", ConnectRole::Dial),
            ("c", ConnectRole::Dial),
            ("d", ConnectRole::Listen),
        ];
        assert_eq!(order, expected);
    }
}
