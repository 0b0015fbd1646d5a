// SPDX-License-Identifier: MIT
// Kept parameters in a file: over a restart, in place, and with files that are none of ours. What the file holds is
// read past the code under test.
#define _DEFAULT_SOURCE
#include "settings_file.h"

#include "unity.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static char folder[] = "/tmp/omnibot-settings-XXXXXX";
static char name[64];
static settings_file_t file;

void setUp(void)
{
    snprintf(name, sizeof name, "%s/parameters", folder);
    file.handle = -1;
}

static void close_file(void)
{
    if (file.handle >= 0) {
        close(file.handle);
    }
    file.handle = -1;
}

void tearDown(void)
{
    close_file();
    remove(name);
}

static void make_file(size_t bytes, int content)
{
    FILE *made = fopen(name, "wb");
    TEST_ASSERT_NOT_NULL(made);
    for (size_t i = 0; i < bytes; i++) {
        fputc(content, made);
    }
    TEST_ASSERT_EQUAL(0, fclose(made));
}

static uint8_t content[SETTINGS_FILE_BYTES + 1];

static size_t read_content(void)
{
    FILE *made = fopen(name, "rb");
    TEST_ASSERT_NOT_NULL(made);
    const size_t bytes = fread(content, 1, sizeof content, made);
    TEST_ASSERT_EQUAL(0, fclose(made));
    return bytes;
}

static parameters_t some_set(float epsilon)
{
    parameters_t set;
    parameters_reset(&set);
    TEST_ASSERT_EQUAL(0, parameters_set(&set, PARAMETER_EPSILON, epsilon));
    return set;
}

static void assert_loads(settings_result_t result, float epsilon)
{
    const parameters_t wanted = some_set(epsilon);
    parameters_t loaded;
    TEST_ASSERT_EQUAL(result, settings_load(&file.memory, &loaded));
    TEST_ASSERT_EQUAL_MEMORY(&wanted, &loaded, sizeof wanted);
}

static void save(float epsilon)
{
    const parameters_t set = some_set(epsilon);
    TEST_ASSERT_TRUE(settings_save(&file.memory, &set));
}

static void test_missing_file_is_made_erased(void)
{
    TEST_ASSERT_TRUE(settings_file_open(&file, name));
    assert_loads(SETTINGS_EMPTY, 0.01f);
    TEST_ASSERT_EQUAL(16384, read_content());
    TEST_ASSERT_EACH_EQUAL_HEX8(0xFF, content, 16384);
}

static void test_set_is_there_after_the_file_is_opened_again(void)
{
    for (int n = 1; n <= 100; n++) { // past both pages
        TEST_ASSERT_TRUE(settings_file_open(&file, name));
        save((float)n / 128.0f);
        close_file();
        TEST_ASSERT_TRUE(settings_file_open(&file, name));
        assert_loads(SETTINGS_OK, (float)n / 128.0f);
        close_file();
    }
    TEST_ASSERT_EQUAL(16384, read_content());
    TEST_ASSERT_EQUAL_MEMORY("OBS1", &content[0], 4); // the third page's worth came back to the first
    TEST_ASSERT_EQUAL_UINT8(65, content[8]);
    TEST_ASSERT_EQUAL_MEMORY("OBS1", &content[8192], 4);
    TEST_ASSERT_EQUAL_UINT8(97, content[8192 + 8]);
}

static void test_save_goes_where_the_log_says(void)
{
    TEST_ASSERT_TRUE(settings_file_open(&file, name));
    save(0.25f);
    save(0.5f);
    read_content();
    TEST_ASSERT_EQUAL_MEMORY("OBS1", &content[0], 4);
    TEST_ASSERT_EQUAL_MEMORY("OBS1", &content[256], 4);
    TEST_ASSERT_EACH_EQUAL_HEX8(0xFF, &content[512], 16384 - 512);
}

static void test_file_of_zeros_is_lost_and_saved_to(void)
{
    make_file(16384, 0);
    TEST_ASSERT_TRUE(settings_file_open(&file, name));
    assert_loads(SETTINGS_LOST, 0.01f);
    save(0.125f);
    assert_loads(SETTINGS_OK, 0.125f);
}

static void test_file_of_another_size_is_refused_and_left_as_it_is(void)
{
    static const size_t sizes[] = {1, 8192, 16383, 16385};
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        make_file(sizes[i], 'x');
        TEST_ASSERT_FALSE(settings_file_open(&file, name));
        TEST_ASSERT_EQUAL(-1, file.handle);
        TEST_ASSERT_EQUAL(sizes[i], read_content());
        TEST_ASSERT_EACH_EQUAL_HEX8('x', content, sizes[i]);
    }
}

static void test_what_is_no_file_is_refused(void)
{
    TEST_ASSERT_FALSE(settings_file_open(&file, folder));
    TEST_ASSERT_FALSE(settings_file_open(&file, "/dev/null"));
    TEST_ASSERT_FALSE(settings_file_open(&file, "/no/such/folder/file"));
}

static void test_file_that_another_holds_is_refused(void)
{
    settings_file_t other;
    TEST_ASSERT_TRUE(settings_file_open(&other, name));
    TEST_ASSERT_FALSE(settings_file_open(&file, name));
    close(other.handle);
    TEST_ASSERT_TRUE(settings_file_open(&file, name));
}

static void test_disk_that_takes_nothing_is_no_save(void)
{
    TEST_ASSERT_TRUE(settings_file_open(&file, name));
    save(0.25f);
    close(file.handle);
    file.handle = open(name, O_RDONLY);
    const parameters_t set = some_set(0.5f);
    TEST_ASSERT_FALSE(settings_save(&file.memory, &set));
    assert_loads(SETTINGS_OK, 0.25f);
}

int main(void)
{
    if (mkdtemp(folder) == NULL) {
        return EXIT_FAILURE;
    }
    UNITY_BEGIN();
    RUN_TEST(test_missing_file_is_made_erased);
    RUN_TEST(test_set_is_there_after_the_file_is_opened_again);
    RUN_TEST(test_save_goes_where_the_log_says);
    RUN_TEST(test_file_of_zeros_is_lost_and_saved_to);
    RUN_TEST(test_file_of_another_size_is_refused_and_left_as_it_is);
    RUN_TEST(test_what_is_no_file_is_refused);
    RUN_TEST(test_file_that_another_holds_is_refused);
    RUN_TEST(test_disk_that_takes_nothing_is_no_save);
    rmdir(folder);
    return UNITY_END();
}
