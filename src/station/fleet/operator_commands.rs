//! Commands of operators for robots that another station owns: from a page to the owner, and the answer back.
//!
//! The request is `{"token": "...", "command": {...}}` with the command as the page has it, the answer `{"result": "accepted"}` or
//! `{"error": "..."}`. The token is the first operator's of the station that sends. The owner accepts it if it is one of an operator
//! there, too: stations that command each other's robots share one file of tokens.

use posebridge_dashboard::{FleetReply, FleetRobotCommand, OperatorTokens, command};
use posebridge_fleet::RobotName;
use posebridge_telemetry::{Input, RobotId};
use posebridge_zenoh::{CommandReply, FleetCommand};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::sync::mpsc;

/// Commands of this station's operators that wait for the station loop.
const MAX_WAITING: usize = 64;
/// Of a request or an answer; a page sends less than a kilobyte.
const MAX_MESSAGE_LEN: usize = 64 * 1024;
/// Of what another station says to the operator.
const MAX_ERROR_CHARS: usize = 400;

/// An operator's command on its way to the robot's owner.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct CommandRequest {
    /// `null` from a station that has none.
    token: Option<String>,
    command: Value,
}

/// What the owner makes of it.
#[derive(Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum CommandAnswer {
    Result(Acceptance),
    Error(String),
}

#[derive(Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Acceptance {
    Accepted,
}

/// The station's part: commands that wait, and the tokens that it knows.
pub(super) struct OperatorCommands {
    sender: mpsc::Sender<FleetRobotCommand>,
    waiting: mpsc::Receiver<FleetRobotCommand>,
    tokens: OperatorTokens,
}

impl OperatorCommands {
    pub(super) fn new() -> Self {
        let (sender, waiting) = mpsc::channel(MAX_WAITING);
        Self { sender, waiting, tokens: OperatorTokens::default() }
    }

    pub(super) fn set_tokens(&mut self, tokens: OperatorTokens) {
        self.tokens = tokens;
    }

    /// Takes a command of this station's operator; it never blocks.
    pub(super) fn submitter(&self) -> impl Fn(FleetRobotCommand) + Send + Sync + 'static {
        let sender = self.sender.clone();
        move |command| {
            let (command, why) = match sender.try_send(command) {
                Ok(()) => return,
                Err(mpsc::error::TrySendError::Full(command)) => (command, "too many commands wait; try again"),
                Err(mpsc::error::TrySendError::Closed(command)) => (command, "the station is ending"),
            };
            command.reply.send(Err(why.to_owned()));
        }
    }

    /// The next one; pending while there is none.
    pub(super) async fn next(&mut self) -> FleetRobotCommand {
        match self.waiting.recv().await {
            Some(command) => command,
            None => std::future::pending().await,
        }
    }

    pub(super) fn try_next(&mut self) -> Option<FleetRobotCommand> {
        self.waiting.try_recv().ok()
    }

    /// What the session sends to the robot's owner.
    pub(super) fn request(&self, robot: RobotName, command: Value, reply: FleetReply) -> FleetCommand {
        let token = self.tokens.first().map(|token| token.expose().to_owned());
        let request = to_bytes(&CommandRequest { token, command });
        let reply = Box::new(move |answer: Result<Vec<u8>, String>| {
            reply.send(answer.and_then(|bytes| read_answer(&bytes)));
        });
        FleetCommand::SendCommand { robot, request, reply }
    }

    /// Answers a request of another station; gives the input for the engine if it is accepted. `robot` is owned by this station.
    pub(super) fn accept(&self, robot: RobotId, request: &[u8], reply: CommandReply) -> Option<Input> {
        let decision = decide(&self.tokens, robot, request);
        reply.send(to_bytes(&match &decision {
            Ok(_) => CommandAnswer::Result(Acceptance::Accepted),
            Err(why) => CommandAnswer::Error(why.clone()),
        }));
        if let Err(why) = &decision {
            tracing::debug!(%robot, "a command of another station's operator is refused: {why}");
        }
        decision.ok()
    }
}

/// The command of an operator here for a robot that this station owns itself.
pub(super) fn own_input(robot: RobotId, command: &Value) -> Result<Input, String> {
    let parsed = command::parse(command.to_string().as_bytes()).map_err(|error| error.to_string())?;
    if parsed.command.is_for_robots() {
        Ok(Input::RobotCommand { robot, command: parsed.command })
    } else {
        Err(format!("`{}` is for a whole station, not for one robot: open the page of that station", parsed.name))
    }
}

fn decide(tokens: &OperatorTokens, robot: RobotId, request: &[u8]) -> Result<Input, String> {
    let request = read_request(request)?;
    tokens.check(request.token.as_deref()).map_err(|error| error.to_string())?;
    own_input(robot, &request.command)
}

fn read_request(bytes: &[u8]) -> Result<CommandRequest, String> {
    let request = (bytes.len() <= MAX_MESSAGE_LEN).then(|| serde_json::from_slice(bytes).ok()).flatten();
    request.ok_or_else(|| {
        "the robot's station does not understand this station's request: run the same version of posebridge at both"
            .to_owned()
    })
}

fn read_answer(bytes: &[u8]) -> Result<(), String> {
    let answer = (bytes.len() <= MAX_MESSAGE_LEN).then(|| serde_json::from_slice(bytes).ok()).flatten();
    match answer {
        Some(CommandAnswer::Result(Acceptance::Accepted)) => Ok(()),
        Some(CommandAnswer::Error(why)) => Err(printable(&why)),
        None => Err(
            "this station does not understand the answer of the robot's station: run the same version of posebridge at both"
                .to_owned(),
        ),
    }
}

/// A text of another station, for a page or a terminal.
fn printable(text: &str) -> String {
    text.chars().map(|letter| if letter.is_control() { ' ' } else { letter }).take(MAX_ERROR_CHARS).collect()
}

/// Plain structs of texts always serialize.
fn to_bytes<T: Serialize>(message: &T) -> Vec<u8> {
    serde_json::to_vec(message).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use posebridge_telemetry::{Address, Command, LinkId};
    use serde_json::json;

    use super::*;

    const OPERATOR: &str = "teacher-teacher-1";

    fn tokens() -> OperatorTokens {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens");
        std::fs::write(&path, format!("operator {OPERATOR}\nreader student-student-1\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        OperatorTokens::read_or_create(&path).unwrap()
    }

    fn robot() -> RobotId {
        RobotId { link: LinkId(1), address: Address::new(7, 1) }
    }

    /// What a station with these tokens sends.
    fn sent_by(tokens: OperatorTokens, command: Value) -> Vec<u8> {
        let mut operators = OperatorCommands::new();
        operators.set_tokens(tokens);
        let (reply, _answer) = FleetReply::pair();
        match operators.request(RobotName::new("ada").unwrap(), command, reply) {
            FleetCommand::SendCommand { request, .. } => request,
            FleetCommand::DeclareToken { .. }
            | FleetCommand::WithdrawToken { .. }
            | FleetCommand::Ask { .. }
            | FleetCommand::Answer { .. }
            | FleetCommand::ExpectRobot(_)
            | FleetCommand::Confirm => panic!("it is a command of an operator"),
        }
    }

    #[test]
    fn a_command_with_the_shared_token_is_an_input_for_the_owner_s_robot() {
        // The sender's id of the robot means nothing here.
        let request = sent_by(tokens(), json!({ "command": "reset-pose", "robot": "9/9/9" }));
        let expected = Input::RobotCommand { robot: robot(), command: Command::ResetPose };
        assert_eq!(decide(&tokens(), robot(), &request), Ok(expected));
    }

    #[test]
    fn without_the_token_nothing_is_taken_and_the_text_says_what_to_configure() {
        let refused = |owner: &OperatorTokens, request: &[u8]| {
            let why = decide(owner, robot(), request).unwrap_err();
            assert!(why.contains("`dashboard.token_file`") && !why.contains(OPERATOR), "{why}");
            why
        };
        let reset = json!({ "command": "reset-pose" });
        let none = OperatorTokens::default();
        assert!(refused(&tokens(), &sent_by(none.clone(), reset.clone())).contains("sent no operator's token"));
        assert!(refused(&none, &sent_by(tokens(), reset.clone())).contains("has no operators' tokens"));
        for wrong in ["student-student-1", "teacher-teacher-2"] {
            let request = to_bytes(&CommandRequest { token: Some(wrong.to_owned()), command: reset.clone() });
            assert!(refused(&tokens(), &request).contains("does not know the operator's token"));
        }
    }

    #[test]
    fn what_is_no_command_for_a_robot_is_refused_with_a_reason() {
        let refused = |command: Value| decide(&tokens(), robot(), &sent_by(tokens(), command)).unwrap_err();
        assert_eq!(
            refused(json!({ "command": "stop-recording" })),
            "`stop-recording` is for a whole station, not for one robot: open the page of that station"
        );
        assert!(refused(json!({ "command": "fly" })).starts_with("`command` is `fly`; there are: "));
        assert!(refused(json!(7)).starts_with("a command is an object"));
        let long = vec![b' '; MAX_MESSAGE_LEN + 1];
        for damaged in [&b"{"[..], br#"{"token":null}"#, br#"{"token":7,"command":{}}"#, &long] {
            let why = decide(&tokens(), robot(), damaged).unwrap_err();
            assert!(why.contains("run the same version"), "{why}");
        }
    }

    #[test]
    fn the_answer_of_the_owner_reaches_the_sender() {
        let accepted = to_bytes(&CommandAnswer::Result(Acceptance::Accepted));
        assert_eq!(accepted, br#"{"result":"accepted"}"#);
        assert_eq!(read_answer(&accepted), Ok(()));
        let refused = br#"{"error":"no\u001b[2J"}"#;
        assert_eq!(read_answer(refused), Err("no [2J".to_owned()));
        let long = to_bytes(&CommandAnswer::Error("x".repeat(10_000)));
        assert_eq!(read_answer(&long).unwrap_err().len(), MAX_ERROR_CHARS);
        for damaged in [&b""[..], br#"{"result":"denied"}"#, b"[]"] {
            assert!(read_answer(damaged).unwrap_err().contains("run the same version"));
        }

        let operators = OperatorCommands::new();
        let (reply, mut answer) = FleetReply::pair();
        let sent = operators.request(RobotName::new("ada").unwrap(), json!({}), reply);
        if let FleetCommand::SendCommand { reply, .. } = sent {
            reply(Err("nobody".to_owned()));
        }
        assert_eq!(answer.try_recv().unwrap(), Err("nobody".to_owned()));
    }

    #[test]
    fn commands_that_nobody_takes_are_refused_when_too_many_wait() {
        let mut operators = OperatorCommands::new();
        let submit = operators.submitter();
        let mut answers: Vec<_> = (0..=MAX_WAITING)
            .map(|_| {
                let (reply, answer) = FleetReply::pair();
                submit(FleetRobotCommand { robot: "ada".to_owned(), command: json!({}), reply });
                answer
            })
            .collect();
        let last = answers.pop().unwrap().try_recv();
        assert_eq!(last.unwrap(), Err("too many commands wait; try again".to_owned()));
        assert!(answers[0].try_recv().is_err(), "it waits");
        assert_eq!(operators.try_next().unwrap().robot, "ada");
        drop(operators);
        assert!(answers[1].try_recv().is_err(), "it is dropped with the station");
    }
}
