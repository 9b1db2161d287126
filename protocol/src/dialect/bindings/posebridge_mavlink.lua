-- The messages of posebridge for Wireshark, beside whatever dissector shows the others. Written by `posebridge dialect --for wireshark`.
--
-- Put it into Wireshark's folder for plugins (Help > About > Folders), or give it to tshark: -X lua_script:posebridge_mavlink.lua
-- Filters: posebridge, posebridge.pb_planar_pose.x > 1. `posebridge dialect --for xml` prints what the fields mean.
--
-- It runs after all dissectors and looks for our frames in every packet, whatever carries them: UDP, TCP, a serial line. A frame is shown
-- if its checksum is right. One that is divided between two TCP segments is not.

local posebridge = Proto("posebridge", "posebridge (MAVLink)")

-- Name, CRC_EXTRA, length, and the fields in the order of the wire: name, type, number of elements (0: no array), unit.
local messages = {
@MESSAGES@}
local sizes = {
  char = 1, uint8 = 1, uint16 = 2, uint32 = 4, uint64 = 8, int8 = 1, int16 = 2, int32 = 4, int64 = 8, float = 4, double = 8,
}
local START = "\253"
local HEADER_BYTES, CHECKSUM_BYTES, SIGNATURE_BYTES = 10, 2, 13
local SIGNED = 1
local bit = bit or bit32

local header = {
  sequence = ProtoField.uint8("posebridge.sequence", "sequence"),
  system = ProtoField.uint8("posebridge.system", "system"),
  component = ProtoField.uint8("posebridge.component", "component"),
  message = ProtoField.uint24("posebridge.message", "message"),
}
local all_fields = { header.sequence, header.system, header.component, header.message }
for _, message in pairs(messages) do
  for _, field in ipairs(message.fields) do
    local make = field[2] == "char" and ProtoField.string or ProtoField[field[2]]
    local label = field[4] and field[1] .. " [" .. field[4] .. "]" or field[1]
    field.proto = make("posebridge." .. message.name:lower() .. "." .. field[1], label)
    all_fields[#all_fields + 1] = field.proto
  end
end
posebridge.fields = all_fields

-- CRC-16/MCRF4XX, as MAVLink computes it.
local function accumulate(sum, byte)
  local mixed = bit.bxor(byte, bit.band(sum, 0xff))
  mixed = bit.band(bit.bxor(mixed, bit.lshift(mixed, 4)), 0xff)
  local high = bit.bxor(bit.lshift(mixed, 8), bit.lshift(mixed, 3))
  return bit.band(bit.bxor(bit.bxor(bit.rshift(sum, 8), high), bit.rshift(mixed, 4)), 0xffff)
end

-- The message of the frame of ours that begins at `start` in the bytes of a packet, and the length of its payload; nil if there is none.
local function frame_at(bytes, start)
  local length, flags = bytes:byte(start + 1, start + 2)
  local id0, id1, id2 = bytes:byte(start + 7, start + 9)
  local message = id2 and messages[id0 + 256 * id1 + 65536 * id2]
  local checksum = start + HEADER_BYTES + (length or 0)
  if not message or length > message.length or #bytes < checksum + 1 then
    return nil
  end
  local sum = 0xffff
  for index = start + 1, checksum - 1 do
    sum = accumulate(sum, bytes:byte(index))
  end
  sum = accumulate(sum, message.crc_extra)
  local low, high = bytes:byte(checksum, checksum + 1)
  if sum ~= low + 256 * high then
    return nil
  end
  local signature = bit.band(flags, SIGNED) ~= 0 and SIGNATURE_BYTES or 0
  return message, length, math.min(HEADER_BYTES + length + CHECKSUM_BYTES + signature, #bytes - start + 1)
end

local function show_frame(frame, message, length, tree)
  local branch = tree:add(posebridge, frame, message.name)
  branch:add(header.sequence, frame(4, 1))
  branch:add(header.system, frame(5, 1))
  branch:add(header.component, frame(6, 1))
  branch:add_le(header.message, frame(7, 3))
  local payload
  if length == message.length then
    payload = frame(HEADER_BYTES, length):tvb()
  else
    -- MAVLink 2 leaves out the zeros at the end.
    local full = frame(HEADER_BYTES, length):bytes()
    full:set_size(message.length)
    payload = full:tvb(message.name .. " in full length")
  end
  local offset = 0
  for _, field in ipairs(message.fields) do
    local size, count = sizes[field[2]], field[3]
    if field[2] == "char" then
      size, count = count, 1
    end
    for _ = 1, math.max(1, count) do
      branch:add_le(field.proto, payload(offset, size))
      offset = offset + size
    end
  end
end

function posebridge.dissector(packet, info, tree)
  local bytes = packet:raw()
  local start = bytes:find(START, 1, true)
  while start do
    local message, length, total = frame_at(bytes, start)
    if message then
      show_frame(packet(start - 1, total), message, length, tree)
      info.cols.info:append(" " .. message.name)
    end
    start = bytes:find(START, start + (total or 1), true)
  end
end

register_postdissector(posebridge)
