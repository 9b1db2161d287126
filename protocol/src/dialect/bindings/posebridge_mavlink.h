/* The messages of posebridge beside the stock C library of MAVLink. Written by `posebridge dialect --for c`.
 *
 * Include it in place of mavlink.h:
 *
 *     #include "posebridge_mavlink.h"
 *
 *     if (mavlink_parse_char(channel, byte, &message, &status) && message.msgid == MAVLINK_MSG_ID_PB_PLANAR_POSE) {
 *         mavlink_pb_planar_pose_t pose;
 *         mavlink_msg_pb_planar_pose_decode(&message, &pose);
 *     }
 *
 * It includes common/mavlink.h; define POSEBRIDGE_STOCK_DIALECT as another header before. Names are those that mavgen gives.
 * `posebridge dialect --for xml` prints what the fields mean. A robot that speaks only these needs no library: brick/c/posebridge_brick.h.
 */
#pragma once

#include <stdint.h>
#include <string.h>

#if defined(MAVLINK_H)
#error "include posebridge_mavlink.h in place of mavlink.h, or before it: the library has to ask it for the checksum seeds of its messages"
#endif
#if defined(MAVLINK_SEPARATE_HELPERS) || defined(MAVLINK_USE_CXX_NAMESPACE) || defined(MAVLINK_GET_MSG_ENTRY)
#error "posebridge_mavlink.h works with the library in its usual form: without MAVLINK_SEPARATE_HELPERS, MAVLINK_USE_CXX_NAMESPACE and MAVLINK_GET_MSG_ENTRY"
#endif

#ifndef POSEBRIDGE_STOCK_DIALECT
#define POSEBRIDGE_STOCK_DIALECT "common/mavlink.h"
#endif

/* The library asks this for the seed and the lengths of a message. */
#define MAVLINK_GET_MSG_ENTRY
struct __mavlink_msg_entry;
static inline const struct __mavlink_msg_entry *mavlink_get_msg_entry(uint32_t msgid);

#include POSEBRIDGE_STOCK_DIALECT

static inline const struct __mavlink_msg_entry *mavlink_get_msg_entry(uint32_t msgid)
{
    static const mavlink_msg_entry_t own[] = {
@ENTRIES@    };
    static const mavlink_msg_entry_t stock[] = MAVLINK_MESSAGE_CRCS;
    uint32_t low = 0, high = sizeof(stock) / sizeof(stock[0]);
    for (uint32_t index = 0; index < sizeof(own) / sizeof(own[0]); index++) {
        if (own[index].msgid == msgid) {
            return &own[index];
        }
    }
    while (low < high) {
        const uint32_t middle = low + (high - low) / 2;
        if (stock[middle].msgid == msgid) {
            return &stock[middle];
        }
        if (stock[middle].msgid < msgid) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    return NULL;
}
@MESSAGES@
