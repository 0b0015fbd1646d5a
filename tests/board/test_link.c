// SPDX-License-Identifier: MIT
// Two lines to one host: answers go where the robot was last asked. SLCAN's bytes are written out here.
#include "link.h"

#include "model.h"
#include "unity.h"

#include <string.h>

enum { NODE = 0 };

static can_t can;
static usart_t usart;
static link_t link;

static uint32_t hardware(reg_t *reg, uint32_t value)
{
    if (reg == &can1.mcr) {
        model_set(&can1.msr, value & 1u);
    }
    for (uint32_t mailbox = 0; mailbox < 3; mailbox++) {
        if (reg == &can1.tx[mailbox].ir && (value & 1u) != 0) {
            model_set(&can1.tsr, model_get(&can1.tsr) & ~(1u << (26 + mailbox)));
        }
    }
    return value;
}

static void start(bool with_can)
{
    model_reset();
    model_on_write(hardware);
    model_set(&can1.tsr, 7u << 26);
    memset(&can, 0, sizeof can);
    memset(&usart, 0, sizeof usart);
    memset(&link, 0, sizeof link);
    can_start(&can, &can1, with_can ? 42000000 : 0, NODE);
    can_tick(&can);
    usart_start(&usart, &usart1, 84000000, 1000000);
    link_init(&link, &can, &usart, NODE);
}

void setUp(void)
{
    start(true);
}

void tearDown(void)
{
    static const char *const own[] = {"can1", "usart1", NULL};
    model_assert_wrote_only(own);
}

// ---- the host's side

static void type(const char *text)
{
    for (; *text != '\0'; text++) {
        TEST_ASSERT_TRUE(ring_put(&usart.received, (uint8_t)*text));
    }
}

static void arrive_by_can(uint16_t id)
{
    model_set(&can1.rfr[0], 1);
    model_set(&can1.rx[0].ir, (uint32_t)id << 21);
    can_interrupt(&can, 0);
}

static const char *typed_back(void)
{
    (void)link_flush(&link);
    static char text[RING_BYTES + 1];
    uint8_t byte;
    size_t length = 0;
    while (ring_take(&usart.to_send, &byte)) {
        text[length++] = (char)byte;
    }
    text[length] = '\0';
    return text;
}

static bool receive(uint16_t id)
{
    frame_t frame;
    return link_receive(&link, &frame) && frame.id == id;
}

static void receive_all(void)
{
    frame_t frame;
    while (link_receive(&link, &frame)) {
    }
}

static void answer(void)
{
    const frame_t frame = {.id = 0x050, .length = 2, .data = {0xAB, 0xCD}};
    TEST_ASSERT_TRUE(link_has_room(&link));
    link_send(&link, &frame);
    (void)link_flush(&link);
}

static void assert_answered_by_can(void)
{
    typed_back();
    model_forget();
    answer();
    TEST_ASSERT_EQUAL_STRING("", typed_back());
    bool requested = false;
    for (int i = 0; i < 3; i++) {
        requested = requested || model_writes_to(&can1.tx[i].ir) == 1;
    }
    TEST_ASSERT_TRUE(requested);
    model_set(&can1.tsr, 7u << 26); // and it is sent
}

static void assert_answered_by_uart(void)
{
    typed_back();
    model_forget();
    answer();
    TEST_ASSERT_EQUAL_STRING("t0502ABCD\r", typed_back());
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_UINT32(0, model_writes_to(&can1.tx[i].ir));
    }
}

// ---- where answers go

static void test_frames_of_both_lines_come_through(void)
{
    arrive_by_can(0x040);
    type("O\rt02023344\r");
    TEST_ASSERT_TRUE(link_has_input(&link));
    TEST_ASSERT_TRUE(receive(0x040));
    TEST_ASSERT_TRUE(receive(0x020));
    TEST_ASSERT_FALSE(link_has_input(&link));
}

static void test_answers_go_by_can_until_something_else_is_asked(void)
{
    assert_answered_by_can();
}

static void test_without_can_answers_go_by_uart_once_it_is_open(void)
{
    start(false);
    answer();
    TEST_ASSERT_EQUAL_STRING("", typed_back());
    TEST_ASSERT_FALSE(link_has_room(&link)); // kept
    TEST_ASSERT_FALSE(link_flush(&link));    // and no reason to stay awake
    type("O\r");
    receive_all();
    TEST_ASSERT_EQUAL_STRING("\rt0502ABCD\r", typed_back());
    TEST_ASSERT_TRUE(link_has_room(&link));
}

static void test_opening_the_uart_turns_answers_to_it(void)
{
    type("O\r");
    receive_all();
    assert_answered_by_uart();
}

static void test_frame_by_can_turns_answers_back(void)
{
    type("O\r");
    receive_all();
    arrive_by_can(0x040);
    TEST_ASSERT_TRUE(receive(0x040));
    assert_answered_by_can();
    type("t0402ABCD\r");
    TEST_ASSERT_TRUE(receive(0x040));
    assert_answered_by_uart();
}

static void test_frame_for_another_node_turns_nothing(void)
{
    type("O\r");
    receive_all();
    arrive_by_can(0x040);
    TEST_ASSERT_TRUE(receive(0x040));
    type("t0412ABCD\r");
    TEST_ASSERT_TRUE(receive(0x041)); // the app ignores it
    assert_answered_by_can();
}

static void test_turning_to_the_uart_takes_back_what_can_has_not_sent(void)
{
    answer();
    type("O\r");
    model_forget();
    receive_all();
    TEST_ASSERT_EQUAL_UINT32(1, model_writes_to(&can1.tsr));
}

// ---- no room

static void test_frame_that_can_cannot_take_is_kept_and_sent_later(void)
{
    answer();
    answer(); // the same identifier: it waits
    TEST_ASSERT_FALSE(link_has_room(&link));
    TEST_ASSERT_TRUE(link_flush(&link)); // to be called again soon
    model_set(&can1.tsr, 7u << 26);
    TEST_ASSERT_FALSE(link_flush(&link));
    TEST_ASSERT_TRUE(link_has_room(&link));
}

static void test_full_uart_loses_no_answer(void)
{
    type("O\r");
    receive_all();
    typed_back();
    enum { ANSWERS = 500 };
    const size_t bytes = strlen("t0502ABCD\r");
    size_t came = 0, sent = 0;
    while (came < ANSWERS * bytes) {
        while (sent < ANSWERS && link_has_room(&link)) {
            answer();
            sent++;
        }
        came += strlen(typed_back());
    }
    TEST_ASSERT_EQUAL(ANSWERS, sent);
    TEST_ASSERT_EQUAL(ANSWERS * bytes, came);
}

static void test_damaged_byte_spoils_its_line_and_no_other(void)
{
    type("O\r");
    receive_all();
    type("t0402AB");
    receive_all();
    atomic_fetch_add(&usart.lost_bytes, 1u);
    type("D\rt0202ABCD\r");
    TEST_ASSERT_TRUE(receive(0x020));
    TEST_ASSERT_FALSE(link_has_input(&link));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_frames_of_both_lines_come_through);
    RUN_TEST(test_answers_go_by_can_until_something_else_is_asked);
    RUN_TEST(test_without_can_answers_go_by_uart_once_it_is_open);
    RUN_TEST(test_opening_the_uart_turns_answers_to_it);
    RUN_TEST(test_frame_by_can_turns_answers_back);
    RUN_TEST(test_frame_for_another_node_turns_nothing);
    RUN_TEST(test_turning_to_the_uart_takes_back_what_can_has_not_sent);
    RUN_TEST(test_frame_that_can_cannot_take_is_kept_and_sent_later);
    RUN_TEST(test_full_uart_loses_no_answer);
    RUN_TEST(test_damaged_byte_spoils_its_line_and_no_other);
    return UNITY_END();
}
