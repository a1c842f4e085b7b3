// Drives a module by lines on stdin: a clock, topics, parameters and commands; tells what it publishes and says.
#include "stand_in.hpp"

#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <sstream>

extern "C" int module_main(int argc, char *argv[]); // the linker makes it the module's

static std::vector<uint8_t> bytes_of(const std::string &hex)
{
    std::vector<uint8_t> made;

    for (size_t i = 0; i + 1 < hex.size(); i += 2) {
        made.push_back(static_cast<uint8_t>(std::stoul(hex.substr(i, 2), nullptr, 16)));
    }

    return made;
}

static int command(std::istringstream &line)
{
    std::vector<std::string> words{"module"};
    std::string word;

    while (line >> word) {
        words.push_back(word);
    }

    std::vector<char *> arguments;

    for (std::string &w : words) {
        arguments.push_back(&w[0]);
    }

    return module_main(static_cast<int>(arguments.size()), arguments.data());
}

int main()
{
    std::string text;

    while (std::getline(std::cin, text)) {
        std::istringstream line(text);
        std::string what, name, value;
        line >> what;

        if (what == "queue") { // as publish, but the listeners do not run yet
            line >> name >> value;
            const std::vector<uint8_t> bytes = bytes_of(value);
            stand_in::topics[name].advertised = true;
            stand_in::publish(name.c_str(), bytes.data(), bytes.size());
            continue;
        }

        if (what == "time") {
            line >> stand_in::now;

        } else if (what == "publish") {
            line >> name >> value;
            const std::vector<uint8_t> bytes = bytes_of(value);
            stand_in::topics[name].advertised = true;
            stand_in::publish(name.c_str(), bytes.data(), bytes.size());

        } else if (what == "parameter") {
            char kind = 0;
            line >> name >> kind >> value;
            const double number = std::strtod(value.c_str(), nullptr); // knows inf and nan

            if (stand_in::parameters.find(name) == stand_in::parameters.end()) {
                stand_in::parameter_order.push_back(name);
            }

            stand_in::Parameter &p = stand_in::parameters[name];
            p.integer = kind == 'i';
            p.real = static_cast<float>(number);
            p.whole = p.integer ? static_cast<int32_t>(number) : 0;

        } else if (what == "advertise" || what == "end") { // another's publication begins or ends
            line >> name;
            stand_in::topics[name].advertised = what == "advertise";

        } else if (what == "read") { // as the ground does
            line >> name;
            const stand_in::Parameter &p = stand_in::parameters[name];
            std::cout << "read " << name << ' ' << (p.integer ? static_cast<double>(p.whole) : static_cast<double>(p.real))
                      << std::endl;

        } else if (what == "flag") {
            line >> name;
            std::cout << "flag " << stand_in::topics[name].advertised << std::endl;

        } else if (what == "forget") { // a parameter
            line >> name;
            auto &order = stand_in::parameter_order;
            order.erase(std::remove(order.begin(), order.end(), name), order.end());

        } else if (what == "obey") {
            stand_in::obedient = true;

        } else if (what == "deaf") {
            stand_in::lockable = false;

        } else if (what == "command") {
            const int result = command(line);
            std::cout << "returned " << result << std::endl;

        } else if (what == "used") {
            for (const auto &entry : stand_in::parameters) {
                if (entry.second.used) {
                    std::cout << "used " << entry.first << std::endl;
                }
            }
        }

        stand_in::work();

        for (const std::string &said : stand_in::said) {
            std::cout << "said " << said << std::endl;
        }

        stand_in::said.clear();
    }

    return 0;
}
