//! What a vehicle answers a ground station that connects: plans, files, logs and the checksum of its parameters, each request with its answer.

use posebridge_protocol::dialect::{Encoder, decode};
use posebridge_protocol::framing::{FrameRef, WireVersion};
use posebridge_protocol::message::{
    FileTransfer, ItemPosition, LogMessage, Message, MissionCurrent, MissionItem, PlanContent, PlanMessage,
};
use posebridge_protocol::session::{
    PlanRequest, PlanService, RequestedMessages, ServedFile, Session, SessionConfig, SessionOutput, SessionSender,
    crc32, most_answers,
};
use posebridge_telemetry::{Address, HostClock, PeerId, TimeDelta};

use crate::support::{GCS, ROBOT, ROVER, STATION, at, golden_frames, with_frame};

const ALL: Address = Address::new(1, 0);
const OPEN: u8 = 4;
const READ: u8 = 5;
const LIST: u8 = 3;
const BURST: u8 = 15;
const ACK: u8 = 128;
const NAK: u8 = 129;

/// A vehicle with an empty file, one that two bursts bring, and three parameters.
fn vehicle() -> Session<HostClock> {
    vehicle_with(PlanService::Empty)
}

fn vehicle_with(plans: PlanService) -> Session<HostClock> {
    let config = SessionConfig {
        own: ROBOT,
        heartbeat: ROVER,
        heartbeat_period: TimeDelta::from_millis(1_000),
        timesync_period: None,
        peer_timeout: TimeDelta::from_millis(5_000),
        requested_messages: RequestedMessages::default(),
        offered_messages: vec![],
    };
    let mut session = Session::new(config, at(0));
    let files = [ServedFile { name: "empty", content: vec![] }, ServedFile { name: "long", content: long_file() }];
    session.serve_as_vehicle(files.to_vec().into(), plans);
    session.offer_parameters([("SLIP_NIS", 10.83), ("GATE_PROB", 0.999), ("_ODD", -0.0)].map(named).into_iter());
    session
}

fn named((name, value): (&str, f32)) -> (String, f32) {
    (name.to_owned(), value)
}

fn long_file() -> Vec<u8> {
    (0..3_000_u32).map(|byte| (byte * 7 % 251) as u8).collect()
}

fn answers_from(session: &mut Session<HostClock>, peer: u32, message: &Message) -> Vec<Message> {
    session.handle_from_peer(at(0), SessionSender { address: GCS, peer: Some(PeerId(peer)) }, message);
    let outputs = std::iter::from_fn(|| session.poll());
    let sent = outputs.map(|output| match output {
        SessionOutput::Send(message) => message,
        other => panic!("{other:?}"),
    });
    let sent: Vec<Message> = sent.collect();
    assert!(sent.len() <= most_answers(message), "it is charged for as many: {sent:?}");
    sent
}

fn answers(session: &mut Session<HostClock>, message: &Message) -> Vec<Message> {
    answers_from(session, 0, message)
}

fn plan(target: Address, plan: u8, content: PlanContent) -> Message {
    Message::Plan(PlanMessage { target, plan, content })
}

#[test]
fn every_request_about_a_plan_is_answered_and_only_an_empty_one_is_taken() {
    let mut session = vehicle();
    let ack = |result| PlanContent::Ack { result };
    let cases = [
        (0, PlanContent::RequestList, PlanContent::Count { items: 0 }),
        (1, PlanContent::RequestList, PlanContent::Count { items: 0 }),
        (2, PlanContent::RequestList, PlanContent::Count { items: 0 }),
        (3, PlanContent::RequestList, ack(3)),
        (255, PlanContent::RequestList, ack(3)),
        (0, PlanContent::Count { items: 1 }, ack(3)),
        (2, PlanContent::Count { items: 0 }, ack(0)),
        (255, PlanContent::ClearAll, ack(0)),
        (0, PlanContent::Request { sequence: 0 }, ack(13)),
        (1, PlanContent::RequestInt { sequence: 9 }, ack(13)),
        (0, PlanContent::RequestPartialList { first: 0, last: -1 }, ack(3)),
        (0, PlanContent::WritePartialList { first: 0, last: 3 }, ack(3)),
    ];
    for (kind, request, answer) in cases {
        for target in [ROBOT, ALL] {
            assert_eq!(answers(&mut session, &plan(target, kind, request)), [plan(GCS, kind, answer)], "{request:?}");
        }
        for target in [STATION, Address::new(0, 0), Address::new(2, 1)] {
            assert_eq!(answers(&mut session, &plan(target, kind, request)), [], "{request:?} to {target}");
        }
    }
    let none = MissionCurrent { sequence: 0, items: u16::MAX, state: 1 };
    let set_current = plan(ROBOT, 0, PlanContent::SetCurrent { sequence: 4 });
    assert_eq!(answers(&mut session, &set_current), [Message::MissionCurrent(none)]);
    assert_eq!(answers(&mut session, &plan(ROBOT, 0, ack(0))), [], "the end of a transfer has no answer");
}

#[test]
fn an_owner_gets_what_concerns_the_mission_and_nothing_of_fences_and_rally_points() {
    let mut session = vehicle_with(PlanService::Owner);
    let item = |plan| MissionItem {
        target: ROBOT,
        plan,
        sequence: 0,
        frame: 1,
        command: 16,
        current: 1,
        autocontinue: 1,
        params: [0.0; 4],
        position: ItemPosition::Integer { x: 0, y: 0 },
        z: 0.0,
    };
    let message = |plan, content| PlanMessage { target: ROBOT, plan, content };
    for request in [
        PlanRequest::Message(message(0, PlanContent::RequestList)),
        PlanRequest::Message(message(255, PlanContent::ClearAll)),
        PlanRequest::Item(item(0)),
    ] {
        let by = SessionSender { address: GCS, peer: Some(PeerId(3)) };
        session.handle_from_peer(
            at(0),
            by,
            &match request {
                PlanRequest::Message(message) => Message::Plan(message),
                PlanRequest::Item(item) => Message::MissionItem(item),
            },
        );
        assert_eq!(session.poll(), Some(SessionOutput::PlanReceived { by, request }));
        assert_eq!(session.poll(), None);
    }
    let refused = |kind| [plan(GCS, kind, PlanContent::Ack { result: 3 })];
    assert_eq!(answers(&mut session, &plan(ROBOT, 1, PlanContent::Count { items: 2 })), refused(1));
    assert_eq!(answers(&mut session, &Message::MissionItem(item(2))), refused(2));
}

#[test]
fn there_are_no_logs_and_a_log_ends_where_it_begins() {
    let mut session = vehicle();
    let list = Message::Log(LogMessage::RequestList { target: ALL, first: 0, last: u16::MAX });
    let none = LogMessage::Entry { unix_s: 0, bytes: 0, id: 0, logs: 0, last: 0 };
    assert_eq!(answers(&mut session, &list), [Message::Log(none)]);
    let read = Message::Log(LogMessage::RequestData { target: ROBOT, id: 5, offset: 90, bytes: 900 });
    let end = LogMessage::Data { id: 5, offset: 90, data: vec![] };
    assert_eq!(answers(&mut session, &read), [Message::Log(end)]);
}

fn request(opcode: u8, session: u8, offset: u32, size: u8, data: &[u8]) -> FileTransfer {
    FileTransfer {
        target: ROBOT,
        sequence: 65_534,
        session,
        opcode,
        size,
        requested_opcode: 0,
        burst_complete: 0,
        offset,
        data: data.to_vec(),
    }
}

fn on_path(opcode: u8, session: u8, path: &str) -> FileTransfer {
    request(opcode, session, 0, path.len() as u8, path.as_bytes())
}

fn transfer(session: &mut Session<HostClock>, peer: u32, request: &FileTransfer) -> Vec<FileTransfer> {
    let answers = answers_from(session, peer, &Message::FileTransfer(request.clone()));
    let answers = answers.into_iter().map(|answer| match answer {
        Message::FileTransfer(answer) => answer,
        other => panic!("{other:?}"),
    });
    let answers: Vec<FileTransfer> = answers.collect();
    for (index, answer) in answers.iter().enumerate() {
        assert_eq!((answer.target, answer.session, answer.requested_opcode), (GCS, request.session, request.opcode));
        assert_eq!(answer.sequence, 65_535_u16.wrapping_add(index as u16));
    }
    answers
}

/// The only answer: its opcode and its data.
fn answer(session: &mut Session<HostClock>, request: &FileTransfer) -> (u8, Vec<u8>) {
    match &transfer(session, 0, request)[..] {
        [answer] => {
            assert_eq!(answer.data.len(), usize::from(answer.size));
            (answer.opcode, answer.data.clone())
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_file_comes_whole_in_bursts_that_end_and_by_single_reads() {
    let mut session = vehicle();
    for path in ["long", "/long", "./long", "/long\0rest"] {
        assert_eq!(answer(&mut session, &on_path(OPEN, 3, path)), (ACK, vec![0xB8, 0x0B, 0, 0]), "{path}");
    }
    for size in [239, 80, 0] {
        let (mut file, mut bursts) = (Vec::new(), 0);
        while file.len() < long_file().len() {
            let frames = transfer(&mut session, 0, &request(BURST, 3, file.len() as u32, size, &[]));
            let (last, others) = frames.split_last().expect("it brings something");
            assert!(last.burst_complete == 1 && others.iter().all(|frame| frame.burst_complete == 0));
            for frame in &frames {
                assert_eq!((frame.offset, usize::from(frame.size)), (file.len() as u32, frame.data.len()));
                file.extend_from_slice(&frame.data);
            }
            bursts += 1;
        }
        assert_eq!(file, long_file());
        assert_eq!(bursts, if size == 80 { 5 } else { 2 }, "eight frames of {size} each");
    }
    assert_eq!(answer(&mut session, &request(BURST, 3, 3_000, 239, &[])), (NAK, vec![6]), "the end");
    assert_eq!(answer(&mut session, &request(READ, 3, 2_990, 239, &[])), (ACK, long_file()[2_990..].to_vec()));
    assert_eq!(answer(&mut session, &request(READ, 3, u32::MAX, 239, &[])), (NAK, vec![6]));
    let crc = answer(&mut session, &on_path(14, 0, "long"));
    assert_eq!(crc, (ACK, crc32(0, &long_file()).to_le_bytes().to_vec()));
}

/// By Python: `zlib.crc32(b"123456789", 0xFFFFFFFF) ^ 0xFFFFFFFF`.
#[test]
fn the_checksum_is_that_of_other_implementations() {
    assert_eq!(crc32(0, b"123456789"), 0x2DFD_2D88);
    assert_eq!(crc32(crc32(0, b"1234"), b"56789"), 0x2DFD_2D88);
}

#[test]
fn what_is_not_there_or_would_write_is_refused_with_its_reason() {
    let mut session = vehicle();
    for path in ["/other", "/long/", "//long", "../long", "/../etc/passwd", ""] {
        assert_eq!(answer(&mut session, &on_path(OPEN, 0, path)), (NAK, vec![10]), "{path}");
    }
    assert_eq!(answer(&mut session, &on_path(LIST, 0, "/folder")), (NAK, vec![10]));
    assert_eq!(answer(&mut session, &request(READ, 0, 0, 239, &[])), (NAK, vec![4]), "nothing is open");
    assert_eq!(answer(&mut session, &request(BURST, 0, 0, 239, &[])), (NAK, vec![4]));
    assert_eq!(answer(&mut session, &request(READ, 0, 0, 240, &[])), (NAK, vec![3]));
    for opcode in [6, 7, 8, 9, 10, 11, 12, 13, 16, 127, 255] {
        assert_eq!(answer(&mut session, &on_path(opcode, 0, "long")), (NAK, vec![7]), "{opcode}");
    }
    for opcode in [ACK, NAK] {
        assert_eq!(transfer(&mut session, 0, &on_path(opcode, 0, "long")), [], "an answer has none");
    }
    for path in ["/", "", "."] {
        let listed = answer(&mut session, &on_path(LIST, 0, path));
        assert_eq!(listed, (ACK, b"Fempty\t0\0Flong\t3000\0".to_vec()));
    }
    assert_eq!(answer(&mut session, &request(LIST, 0, 2, 1, b"/")), (NAK, vec![6]));
    assert_eq!(answer(&mut session, &on_path(OPEN, 0, "empty")), (ACK, vec![0; 4]));
    assert_eq!(answer(&mut session, &request(READ, 0, 0, 239, &[])), (NAK, vec![6]));
}

#[test]
fn sessions_are_kept_for_each_client_and_there_are_only_so_many() {
    let mut session = vehicle();
    let read = |session: &mut Session<HostClock>, peer| transfer(session, peer, &request(READ, 1, 0, 4, &[]))[0].opcode;
    transfer(&mut session, 1, &on_path(OPEN, 1, "long"));
    transfer(&mut session, 2, &on_path(OPEN, 1, "long"));
    // Two ground stations may have one address: the end of one transfer ends not the other.
    transfer(&mut session, 1, &request(1, 1, 0, 0, &[]));
    assert_eq!((read(&mut session, 1), read(&mut session, 2)), (NAK, ACK));
    transfer(&mut session, 2, &request(2, 0, 0, 0, &[]));
    assert_eq!(read(&mut session, 2), NAK);
    for peer in 10..27 {
        transfer(&mut session, peer, &on_path(OPEN, 1, "long"));
    }
    assert_eq!((read(&mut session, 10), read(&mut session, 11), read(&mut session, 26)), (NAK, ACK, ACK));
}

#[test]
fn a_client_that_opens_many_files_ends_its_own_transfers_alone() {
    let mut session = vehicle();
    let open = |session: &mut Session<HostClock>, address, peer, number| {
        let sender = SessionSender { address, peer: Some(PeerId(peer)) };
        session.handle_from_peer(at(0), sender, &Message::FileTransfer(on_path(OPEN, number, "long")));
        while session.poll().is_some() {}
    };
    let read =
        |session: &mut Session<HostClock>, number| transfer(session, 2, &request(READ, number, 0, 4, &[]))[0].opcode;
    open(&mut session, GCS, 2, 1);
    for number in 0..40 {
        open(&mut session, GCS, 1, number);
        // The same peer under other addresses.
        open(&mut session, Address::new(number, 190), 1, 1);
    }
    assert_eq!(read(&mut session, 1), ACK);
    for number in 2..4 {
        open(&mut session, GCS, 2, number);
    }
    assert_eq!([1, 2, 3].map(|number| read(&mut session, number)), [NAK, ACK, ACK], "two of each client");
}

/// By Python over the names by rising order: `crc = zlib.crc32(name + struct.pack("<f", value), crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF`.
#[test]
fn the_checksum_of_parameters_is_told_on_request_and_setting_it_ends_the_list() {
    let mut session = vehicle();
    let read = Message::ParamRequestRead { target: ALL, name: "_HASH_CHECK".to_owned(), index: -1 };
    assert_eq!(answers(&mut session, &read), [Message::ParamHash { hash: PARAMETERS_HASH, count: 3 }]);
    session.report_parameter(1, 0.5);
    assert_ne!(answers(&mut session, &read), [Message::ParamHash { hash: PARAMETERS_HASH, count: 3 }]);
    assert_eq!(answers(&mut session, &Message::ParamRequestList { target: ROBOT }), []);
    let listed = |session: &mut Session<HostClock>, now| {
        session.tick(at(now));
        let outputs = std::iter::from_fn(|| session.poll());
        outputs.filter(|output| matches!(output, SessionOutput::Send(Message::ParamValue { .. }))).count()
    };
    assert_eq!(listed(&mut session, 20), 1);
    let known = Message::ParamSet { target: ROBOT, name: "_HASH_CHECK".to_owned(), value: 0.0 };
    session.handle(at(30), GCS, &known);
    assert_eq!(session.poll(), None);
    assert_eq!(listed(&mut session, 40), 0);
}

const PARAMETERS_HASH: u32 = 0x854E_9817;

/// Cut anywhere, a payload decodes to something that encodes and decodes to the same again: zeros are cut from its end on the wire.
#[test]
fn a_payload_that_is_cut_anywhere_still_has_a_meaning() {
    let frames = golden_frames();
    let services = frames.iter().filter(|(name, _)| {
        ["mission_", "file_transfer_", "log_", "param_hash", "available_", "component_"]
            .iter()
            .any(|kind| name.starts_with(kind))
    });
    let mut cuts = 0;
    for (name, bytes) in services {
        let (message_id, payload) = with_frame(bytes, |frame| (frame.message_id, frame.payload.to_vec()));
        for length in 0..=payload.len() {
            let cut = FrameRef {
                version: WireVersion::V2,
                message_id,
                source: GCS,
                sequence: 0,
                payload: &payload[..length],
                raw: &[],
            };
            let Some(message) = decode(&cut).expect("no cut is invalid") else {
                // Without its name a parameter is another one.
                assert_eq!(name, "param_hash");
                continue;
            };
            let mut again = Vec::new();
            assert!(Encoder::new(WireVersion::V2).encode(GCS, &message, &mut again) > 0);
            assert_eq!(with_frame(&again, decode).expect("it is ours"), Some(message), "{name} cut to {length}");
            cuts += 1;
        }
    }
    assert!(cuts > 500, "{cuts}");
}
