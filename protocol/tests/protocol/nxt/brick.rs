//! A double of an NXT, written from the firmware's interface and LEGO's developer kit, not from our encoder: it takes requests apart
//! byte by byte and answers 30 ms later, one after the other.

use std::collections::VecDeque;

/// Microseconds from a request to its reply: the radio chip turns around.
pub(crate) const TURN_AROUND_MICROS: i64 = 30_000;

/// By how much the motor's own count, that of its block and that of its rotation differ here.
const OTHER_COUNTS: [i32; 3] = [0, 1_000, 2_000];

/// What a brick allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum IoMapLimit {
    /// Data bytes of one read of an IO map; more give status 91.
    UpTo(u16),
    /// The firmware does not know the command: status BE.
    Unknown,
}

/// What becomes of GETBATTERYLEVEL.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BatteryAnswer {
    Millivolts(u16),
    /// The firmware does not know the command: status BE.
    Unknown,
    Silence,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Port {
    pub(crate) kind: u8,
    pub(crate) raw: u16,
    pub(crate) invalid_for: u8,
    /// What the sensor on the bus answers from its register 42, or for the thermometer from pointer 00.
    pub(crate) registers: [u8; 6],
    pub(crate) is_plugged: bool,
    ring: [u8; 16],
    end: u8,
    pub(crate) prepared: Vec<u8>,
}

impl Default for SimulatedNxt {
    fn default() -> Self {
        Self::new()
    }
}

/// The brick.
#[derive(Clone, Debug)]
pub(crate) struct SimulatedNxt {
    pub(crate) tick_offset_ms: i64,
    /// The motors' true angles at an instant in microseconds, degrees.
    pub(crate) drive: fn(i64) -> [i32; 3],
    /// Where they were when the counters were zeroed.
    pub(crate) base: [i32; 3],
    pub(crate) ports: [Port; 4],
    pub(crate) io_map_limit: IoMapLimit,
    /// Replies that its transmitter holds at the same time; more are dropped.
    pub(crate) most_replies: usize,
    pub(crate) battery: BatteryAnswer,
    pub(crate) has_program: bool,
    /// Messages that were put into mailbox 0.. with their final zero.
    pub(crate) mailbox: Vec<(u8, Vec<u8>)>,
    pub(crate) keep_alives: usize,
    pub(crate) requests: Vec<Vec<u8>>,
    pub(crate) inbox: Vec<u8>,
    /// Replies on their way, with the instants at which they arrive, microseconds.
    pub(crate) replies: VecDeque<(i64, Vec<u8>)>,
    pub(crate) free_at: i64,
}

impl SimulatedNxt {
    pub(crate) fn new() -> Self {
        Self {
            tick_offset_ms: 5_000,
            drive: |_| [0; 3],
            base: [0; 3],
            ports: Default::default(),
            io_map_limit: IoMapLimit::UpTo(119),
            most_replies: 2,
            battery: BatteryAnswer::Millivolts(7_900),
            has_program: false,
            mailbox: Vec::new(),
            keep_alives: 0,
            requests: Vec::new(),
            inbox: Vec::new(),
            replies: VecDeque::new(),
            free_at: 0,
        }
    }

    /// Bytes from the host: each telegram behind its length.
    pub(crate) fn push_bytes(&mut self, now_micros: i64, bytes: &[u8]) {
        self.inbox.extend_from_slice(bytes);
        while self.inbox.len() >= 2 {
            let length = usize::from(self.inbox[0]) + 256 * usize::from(self.inbox[1]);
            if self.inbox.len() < 2 + length {
                return;
            }
            let telegram: Vec<u8> = self.inbox.drain(..2 + length).skip(2).collect();
            self.handle_telegram(now_micros, &telegram);
        }
    }

    fn handle_telegram(&mut self, now_micros: i64, telegram: &[u8]) {
        self.requests.push(telegram.to_vec());
        self.replies.retain(|(at, _)| *at > now_micros || *at == i64::MAX);
        // It handles a request in the middle of the turn-around.
        let start = now_micros.max(self.free_at);
        let values = self.execute(start + TURN_AROUND_MICROS / 2, telegram);
        if telegram[0] & 0x80 != 0 || (telegram == [0x00, 0x0B] && self.battery == BatteryAnswer::Silence) {
            return;
        }
        if self.pending(now_micros) >= self.most_replies {
            return;
        }
        let arrives = start + TURN_AROUND_MICROS;
        self.free_at = arrives;
        let mut reply = vec![(values.len() + 2) as u8, 0, 0x02, telegram[1]];
        reply.extend(values);
        self.replies.push_back((arrives, reply));
    }

    fn pending(&self, now_micros: i64) -> usize {
        self.replies.iter().filter(|(at, _)| *at > now_micros).count()
    }

    /// The next reply that has arrived.
    pub(crate) fn queue_reply(&mut self, now_micros: i64) -> Option<Vec<u8>> {
        if self.next_reply()? > now_micros {
            return None;
        }
        self.replies.pop_front().map(|(_, reply)| reply)
    }

    /// When the next reply arrives.
    pub(crate) fn next_reply(&self) -> Option<i64> {
        self.replies.front().map(|(at, _)| *at)
    }

    /// Every reply on its way comes so much later.
    pub(crate) fn stall(&mut self, until_micros: i64) {
        for (at, _) in &mut self.replies {
            *at = (*at).max(until_micros);
        }
        self.free_at = self.free_at.max(until_micros);
    }

    /// The start or end of a program zeroes motors and sensors.
    pub(crate) fn restart_program(&mut self, now_micros: i64) {
        self.base = (self.drive)(now_micros);
        for port in &mut self.ports {
            port.kind = 0;
        }
    }

    /// It is switched off and on: the clock begins anew, too.
    pub(crate) fn restart(&mut self, now_micros: i64) {
        self.restart_program(now_micros);
        self.tick_offset_ms = -now_micros / 1_000;
    }

    fn counts(&self, at_micros: i64) -> [i32; 3] {
        let angles = (self.drive)(at_micros);
        std::array::from_fn(|motor| angles[motor] - self.base[motor])
    }

    /// Status and the bytes after it.
    fn execute(&mut self, at_micros: i64, telegram: &[u8]) -> Vec<u8> {
        let port = telegram.get(2).copied().unwrap_or(0);
        let index = usize::from(port);
        match (telegram[0] & 0x7F, telegram[1]) {
            (0x01, 0x88) => vec![0x00, 0x7C, 0x01, 0x1F, 0x01],
            (0x01, 0x94) => self.io_map(at_micros, telegram),
            (0x00, 0x05) => self.set_input_mode(index, telegram[3]),
            (0x00, 0x06) if index < 3 => self.output_state(at_micros, port),
            (0x00, 0x07) if index < 4 => self.input_values(port),
            (0x00, 0x09) => self.message_write(telegram),
            (0x00, 0x0B) => match self.battery {
                BatteryAnswer::Millivolts(millivolts) => [&[0x00][..], &millivolts.to_le_bytes()].concat(),
                BatteryAnswer::Unknown | BatteryAnswer::Silence => vec![0xBE],
            },
            (0x00, 0x0D) => {
                self.keep_alives += 1;
                vec![0x00, 0xC0, 0x27, 0x09, 0x00]
            }
            (0x00, 0x0F) if index < 4 => self.ls_write(index, telegram),
            (0x00, 0x10) if index < 4 => self.ls_read(index),
            (0x00, 0x06 | 0x07 | 0x0F | 0x10) => vec![0xF0],
            _ => vec![0xBE],
        }
    }

    fn set_input_mode(&mut self, index: usize, kind: u8) -> Vec<u8> {
        let Some(port) = self.ports.get_mut(index) else {
            return vec![0xF0];
        };
        port.kind = kind;
        port.invalid_for = 2;
        vec![0x00]
    }

    fn output_state(&self, at_micros: i64, port: u8) -> Vec<u8> {
        let mut values = vec![0x00, port, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        let count = self.counts(at_micros)[usize::from(port)];
        for relative in OTHER_COUNTS {
            values.extend((count + relative).to_le_bytes());
        }
        values
    }

    fn input_values(&mut self, port: u8) -> Vec<u8> {
        let sensor = &mut self.ports[usize::from(port)];
        let is_valid = sensor.invalid_for == 0;
        sensor.invalid_for = sensor.invalid_for.saturating_sub(1);
        let mut values = vec![0x00, port, u8::from(is_valid), 0, sensor.kind, 0];
        values.extend(sensor.raw.to_le_bytes());
        values.extend([0; 6]);
        values
    }

    fn message_write(&mut self, telegram: &[u8]) -> Vec<u8> {
        if !self.has_program {
            return vec![0xEC];
        }
        if usize::from(telegram[3]) != telegram.len() - 4 || telegram.last() != Some(&0) {
            return vec![0xED];
        }
        self.mailbox.push((telegram[2], telegram[4..].to_vec()));
        vec![0x00]
    }

    fn ls_write(&mut self, index: usize, telegram: &[u8]) -> Vec<u8> {
        let port = &mut self.ports[index];
        if port.kind != 0x0B {
            return vec![0xE0];
        }
        if !port.is_plugged {
            return vec![0xDD];
        }
        let written = &telegram[5..];
        assert_eq!(usize::from(telegram[3]), written.len());
        if telegram[4] == 0 {
            port.prepared = written.to_vec();
        }
        for register in 0..usize::from(telegram[4]) {
            port.ring[usize::from(port.end)] = port.registers[register];
            port.end = (port.end + 1) % 16;
        }
        vec![0x00]
    }

    fn ls_read(&mut self, index: usize) -> Vec<u8> {
        let port = &mut self.ports[index];
        if !port.is_plugged {
            return vec![0xDD];
        }
        let mut values = vec![0x00, port.end];
        values.extend(port.ring);
        port.end = 0;
        values
    }

    fn io_map(&mut self, at_micros: i64, telegram: &[u8]) -> Vec<u8> {
        let IoMapLimit::UpTo(most) = self.io_map_limit else {
            return vec![0xBE];
        };
        let number = |at: usize| u16::from(telegram[at]) + 256 * u16::from(telegram[at + 1]);
        let (offset, length) = (usize::from(number(6)), number(8));
        let module = match telegram[2..6] {
            [0x01, 0x00, 0x01, 0x00] => self.command_module(at_micros),
            [0x01, 0x00, 0x02, 0x00] => self.output_module(at_micros),
            [0x01, 0x00, 0x03, 0x00] => self.input_module(),
            [0x01, 0x00, 0x0B, 0x00] => self.low_speed_module(),
            _ => Vec::new(),
        };
        let end = offset + usize::from(length);
        if length > most || end > module.len() {
            return [&[0x91], &telegram[2..6], &[0x00, 0x00]].concat();
        }
        [&[0x00], &telegram[2..6], &telegram[8..10], &module[offset..end]].concat()
    }

    fn command_module(&self, at_micros: i64) -> Vec<u8> {
        let tick = (at_micros / 1_000 + self.tick_offset_ms) as u32;
        [&[0; 20][..], &tick.to_le_bytes()].concat()
    }

    fn output_module(&self, at_micros: i64) -> Vec<u8> {
        let mut module = vec![0; 100];
        for (motor, count) in self.counts(at_micros).iter().enumerate() {
            for (index, relative) in OTHER_COUNTS.into_iter().enumerate() {
                let at = 32 * motor + 4 * index;
                module[at..at + 4].copy_from_slice(&(count + relative).to_le_bytes());
            }
        }
        module
    }

    fn input_module(&mut self) -> Vec<u8> {
        let mut module = vec![0; 80];
        for (index, port) in self.ports.iter_mut().enumerate() {
            let at = 20 * index;
            module[at + 2..at + 4].copy_from_slice(&port.raw.to_le_bytes());
            module[at + 8] = port.kind;
            module[at + 16] = u8::from(port.invalid_for > 0);
            port.invalid_for = port.invalid_for.saturating_sub(1);
        }
        module
    }

    fn low_speed_module(&self) -> Vec<u8> {
        let mut module = vec![0; 168];
        for (index, port) in self.ports.iter().enumerate() {
            let at = 19 * index;
            module[at..at + 16].copy_from_slice(&port.ring);
            module[at + 16] = port.end;
        }
        module
    }
}
